"""Exposure is one factor, exactly."""

import torch

from lfref.simulator.effects.response import Exposure

from .conftest import GRID, applied


def test_all_radiances_are_multiplied():
    views = torch.rand(2, 3, 3, 4, 5)
    assert torch.equal(applied(Exposure(2.5), views), 2.5 * views)


def test_only_gain_1_is_inert():
    assert Exposure().inert(GRID) == "gain is 1"
    assert Exposure(1.01).inert(GRID) is None
