"""Spacing: rows of views that are farther apart than columns are found; even grids stay even."""

import math
from types import SimpleNamespace

import pytest
import torch

from lfref.captures import spacing
from lfref.captures.registration import positions_of
from lfref.lightfield import LightField

from . import displaced
from .scenes import clean, registered, registered_clean


@pytest.mark.parametrize("ratio", [0.9, 1.04, 1.2])
def test_a_known_ratio_is_estimated_to_half_a_percent(ratio):
    defect = spacing.find(registered(displaced.stretched("leaves", ratio)))
    assert defect.reason_to_skip() is None
    assert defect.ratio == pytest.approx(ratio, rel=5e-3)
    assert f"[{defect.ratio:.4f},1]" in defect.summary()


def test_every_second_column_makes_rows_half_as_far_apart():
    defect = spacing.find(registered(LightField(clean("leaves").views[:, ::2])))
    assert defect.estimate == pytest.approx(0.5, rel=0.01)


@pytest.mark.parametrize("name", ["leaves", "plane", "stripes", "window", "lattice"])
def test_even_grids_stay_even(name):
    assert spacing.find(registered_clean(name)).reason_to_skip() is not None


def test_a_single_row_of_views_has_no_spacing():
    defect = spacing.find(registered(LightField(clean("leaves").views[3:4])))
    assert math.isnan(defect.estimate)
    assert "too few rows and columns" in defect.reason_to_skip()


def test_rows_move_to_their_distance_and_columns_stay():
    field = LightField(torch.rand(3, 5, 1, 8, 8))
    positions = spacing.SpacingDefect(1.1, 1.1, 0.01).corrected(field).positions
    assert positions[:, :, 0].tolist() == [[pytest.approx(v)] * 5 for v in (-1.1, 0, 1.1)]
    assert positions[:, :, 1].tolist() == [[-2, -1, 0, 1, 2]] * 3


@pytest.mark.parametrize(
    ("excess", "error", "outermost", "scatter", "expected"),
    [
        (0.11, 0.02, 9.0, 0.0, True),  # five standard errors
        (0.09, 0.02, 9.0, 0.0, False),
        (0.022, 0.0, 1.0, 0.0, True),  # a shift of .04 pixels of the outermost view
        (0.018, 0.0, 1.0, 0.0, False),
        (0.5, 0.0, 9.0, 1.5, True),  # .6 of the scatter of patches
        (0.5, 0.0, 9.0, 1.9, False),
    ],
)
def test_a_ratio_counts_if_it_is_certain_shows_and_exceeds_the_scatter(excess, error, outermost, scatter, expected):
    assert spacing.is_certain(excess, error, torch.full((20,), 2.0), outermost, scatter) == expected


def patches(disparities, precision):
    """A registration of patches with these disparities [K, 2] and precisions [K, 2]."""
    return SimpleNamespace(
        explanation=SimpleNamespace(
            disparities=disparities, precision=precision, shifts=torch.zeros(49, 2, dtype=torch.float64)
        ),
        positions=positions_of(clean("leaves")),
    )


def differing(n, mean, difference, precision):
    """Patches whose disparities along rows and columns differ by so much."""
    disparities = torch.stack([mean + difference / 2, mean - difference / 2], 1)
    return patches(disparities, precision.expand(n, 2)), torch.arange(n)


SIGNS = (1 - 2.0 * (torch.arange(400) % 2)).double()
OTHER_SIGNS = (1 - 2.0 * (torch.arange(400) // 2 % 2)).double()


def test_a_ratio_of_little_evidence_is_half_as_far_from_one():
    # A prior of standard deviation .2 has as much information as these patches. With Cauchy weights, one at a standard
    # deviation pulls by .48 of its distance.
    deviation = 0.1
    mean = SIGNS * deviation * (25 / (0.48 * 400)) ** 0.5
    precision = torch.tensor(2 / deviation**2, dtype=torch.float64)
    fit, _ = spacing.fit_ratio(*differing(400, mean, 0.1 * mean + deviation * OTHER_SIGNS, precision))
    assert float(fit.values[1]) == pytest.approx(0.05, rel=0.2)


def test_a_constant_difference_of_more_than_two_thousandths_of_a_pixel_per_view_is_unlikely():
    # A prior of that standard deviation has as much information as these patches; see above.
    deviation = 0.002 * (0.48 * 400) ** 0.5
    precision = torch.tensor(2 / deviation**2, dtype=torch.float64)
    fit, _ = spacing.fit_ratio(*differing(400, SIGNS, 1e-3 + deviation * OTHER_SIGNS, precision))
    assert float(fit.values[0]) == pytest.approx(5e-4, rel=0.2)
