"""Clipping cuts at its limits, and is inert only without any."""

import math

import torch

from lfref.simulator.effects.response import Clipping

from .conftest import GRID, applied


def test_values_beyond_the_limits_are_cut_off():
    views = torch.tensor([-1.0, 0.0, 0.3, 1.0, 7.0])
    assert applied(Clipping(), views).tolist() == torch.tensor([0, 0, 0.3, 1, 1]).tolist()
    assert applied(Clipping(0.5, math.inf), views).tolist() == [0.5, 0.5, 0.5, 1, 7]


def test_without_limits_it_is_inert():
    assert Clipping(-math.inf, math.inf).inert(GRID) == "there are no limits"
    assert Clipping().inert(GRID) is None
    assert Clipping(-math.inf, 1e6).inert(GRID) is None
