"""Spacing: rows of views that are farther apart than columns are found; even grids stay even."""

import math

import pytest
import torch

from lfref.captures import spacing
from lfref.captures.estimates import Estimates
from lfref.lightfield import LightField

from . import displaced


@pytest.mark.parametrize("ratio", [0.9, 1.04, 1.2])
def test_a_known_ratio_comes_back_to_half_a_percent(ratio):
    found = spacing.find(Estimates(displaced.stretched("leaves", ratio)))
    assert found.reason_to_skip() is None
    assert found.ratio == pytest.approx(ratio, rel=5e-3)
    assert f"[{found.ratio:.4f},1]" in found.summary()


def test_every_second_column_makes_rows_half_as_far_apart():
    field = displaced.scene("leaves")
    found = spacing.find(Estimates(LightField(field.views[:, ::2])))
    assert found.estimate == pytest.approx(0.5, rel=0.01)


@pytest.mark.parametrize("name", ["leaves", "plane", "stripes", "window", "lattice", "wall"])
def test_even_grids_stay_even(name):
    assert spacing.find(displaced.estimates(name)).reason_to_skip() is not None


def test_what_cannot_be_told_is_not():
    found = spacing.find(Estimates(LightField(torch.rand(1, 5, 3, 80, 96))))
    assert math.isnan(found.estimate)
    assert "too few rows and columns" in found.reason_to_skip()


def test_rows_go_to_their_distance_and_columns_keep_theirs():
    field = LightField(torch.rand(3, 5, 1, 8, 8))
    positions = spacing.SpacingDefect(1.1, 1.1, 0.01).corrected(field).positions
    assert positions[:, :, 0].tolist() == [[pytest.approx(v)] * 5 for v in (-1.1, 0, 1.1)]
    assert positions[:, :, 1].tolist() == [[-2, -1, 0, 1, 2]] * 3
