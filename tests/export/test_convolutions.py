"""Shift-and-sum as convolutions: the operator itself, at any size, to its edges."""

import itertools

import pytest
import torch

from lfref.errors import InputError
from lfref.export.convolutions import Sum, SumOfViews
from lfref.refocus import apertures
from lfref.refocus.shift.shift_and_sum import shift_and_sum

SLOPES = (-7.0, -1.3, -0.5, 0.0, 0.21, 1.0, 2.5)


def both(options, views):
    """What the convolutions make, and what the operator makes of it in float64."""
    weights = None if options.weights is None else torch.tensor(options.weights)
    expected = shift_and_sum(
        views.double(),
        options.slopes,
        options.interpolation,
        options.border,
        weights,
        options.fill,
        options.disparity,
    )
    return SumOfViews(options)(views), expected.float()


@pytest.mark.parametrize("border", ["renormalize", "edge", "zero"])
@pytest.mark.parametrize("interpolation", ["nearest", "linear", "cubic"])
@pytest.mark.parametrize("fill", [0.0, 1.0])
def test_convolutions_make_the_planes_of_the_operator(interpolation, border, fill):
    views = torch.rand(2, 5, 5, 1, 45, 40)
    result, expected = both(Sum(SLOPES, (5, 5), interpolation, border, fill, 0.3), views)
    torch.testing.assert_close(result, expected, atol=3e-6, rtol=0)


@pytest.mark.parametrize("grid", [(1, 1), (2, 3), (7, 4)])
def test_any_grid_and_number_of_channels_is_summed(grid):
    views = torch.rand(1, *grid, 1, 51, 44)
    torch.testing.assert_close(*both(Sum(SLOPES[1:], grid), views), atol=3e-6, rtol=0)


def test_an_aperture_weighs_the_views():
    weights = tuple(map(tuple, apertures.disc((5, 5), 4.0).tolist()))
    views = torch.rand(1, 5, 5, 3, 40, 40)
    torch.testing.assert_close(*both(Sum(SLOPES, (5, 5), weights=weights), views), atol=3e-6, rtol=0)


def test_a_pixel_is_what_a_slow_loop_adds_up():
    views, slope = torch.rand(1, 3, 3, 1, 12, 13), 0.75
    result = SumOfViews(Sum((slope,), (3, 3)))(views)[0, 0, 0]
    for y, x in ((0, 0), (5, 6), (11, 12), (0, 7)):
        total = count = 0.0
        for v, u in itertools.product(range(3), repeat=2):
            row, column = y + slope * (v - 1), x + slope * (u - 1)
            if 0 <= row <= 11 and 0 <= column <= 12:
                total, count = total + read(views[0, v, u, 0], row, column), count + 1
        assert abs(float(result[y, x]) - total / count) < 1e-6


def read(image, row, column):
    total = 0.0
    for y, x in itertools.product((int(row), int(row) + 1), (int(column), int(column) + 1)):
        weight = max(0, 1 - abs(row - y)) * max(0, 1 - abs(column - x))
        total += weight * float(image[y, x]) if weight else 0.0
    return total


@pytest.mark.parametrize(
    ("interpolation", "border", "message"), [("exact", "edge", "few samples"), ("cubic", "wrap", "border")]
)
def test_what_is_no_short_convolution_is_refused(interpolation, border, message):
    with pytest.raises(InputError, match=message):
        Sum((0.0,), (3, 3), interpolation, border)
