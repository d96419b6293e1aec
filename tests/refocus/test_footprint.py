"""Cells of the aperture: taps of a box against its response, levels of widths, and what is refused."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lfref.errors import InputError
from lfref.refocus import footprint

VIEWS = torch.zeros(2, 5, 5, 3, 8, 9)
SLOPES = torch.tensor([-1.0, 0.5], dtype=torch.float64)
WIDTHS = st.floats(0, 40)


def filtered(weights, frequencies):
    """What taps do to frequencies, summed up one by one."""
    middle = len(weights) // 2
    waves = (weight * torch.cos(2 * torch.pi * frequencies * (n - middle)) for n, weight in enumerate(weights))
    return sum(waves)


@pytest.mark.parametrize(("highest", "error"), [(0.2, 0.0035), (0.3, 0.009), (0.4, 0.035), (0.5, 0.18)])
def test_the_response_is_that_of_a_box(highest, error):
    frequencies = torch.linspace(0, highest, 81, dtype=torch.float64)
    for width in torch.linspace(0, 16, 161, dtype=torch.float64):
        own = footprint.response(width[None], frequencies)[0]
        assert float((filtered(footprint.taps(float(width)), frequencies) - own).abs().max()) < error


def test_a_natural_picture_is_blurred_as_by_a_box():
    frequencies = torch.linspace(0.002, 0.4, 200, dtype=torch.float64)
    power = 1 / frequencies.square()
    for width in torch.linspace(0, 16, 161, dtype=torch.float64):
        error = filtered(footprint.taps(float(width)), frequencies) - footprint.response(width[None], frequencies)[0]
        assert float((error.square() * power).sum() / power.sum()) < 0.0005**2


@given(WIDTHS)
def test_weights_are_of_sum_1_and_symmetric(width):
    weights = footprint.taps(width)
    assert len(weights) == 2 * footprint.radius(width) + 1
    assert sum(weights) == pytest.approx(1, abs=1e-12)
    assert weights == weights[::-1]


@pytest.mark.parametrize("width", [1e-300, 1e-12, 1e-6, 1e-4])
def test_a_narrow_box_is_nearly_a_point(width):
    weights = footprint.taps(width)
    assert weights[len(weights) // 2] == pytest.approx(1, abs=width + 1e-12)
    assert all(abs(weight) <= width + 1e-12 for n, weight in enumerate(weights) if n != len(weights) // 2)


@given(st.floats(0.01, 30))
def test_the_spread_is_that_of_a_box(width):
    weights = footprint.taps(width)
    variance = sum(weight * (n - len(weights) // 2) ** 2 for n, weight in enumerate(weights))
    assert variance == pytest.approx(width**2 / 12, rel=0.05, abs=0.03)


@given(st.integers(0, 40))
def test_a_level_lies_at_its_own_width(level):
    place = footprint.place(torch.tensor(footprint.width(level), dtype=torch.float64).square())
    assert float(place) == pytest.approx(level, abs=1e-9)


def test_places_are_smooth_at_width_0():
    width = torch.zeros((), dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(footprint.place(width.square()), width)
    assert float(slope) == 0


@pytest.mark.parametrize(("low", "high", "expected"), [(0.0, 0.0, [0]), (0.2, 1.9, [0, 1, 2]), (3.0, 4.0, [3, 4])])
def test_spanned_are_those_around_the_places(low, high, expected):
    assert list(footprint.spanned(torch.tensor([low, high]))) == expected


def test_two_levels_make_the_response_of_the_widths_between():
    frequencies = torch.linspace(0, 0.4, 17, dtype=torch.float64)
    power = 1 / (frequencies[:, None].square() + frequencies.square()).clamp(min=1 / 200**2)

    def response(width):
        along = footprint.response(torch.tensor([width], dtype=torch.float64), frequencies)[0]
        return along[:, None] * along

    for width in torch.linspace(0.02, 8, 200).tolist():
        place = float(footprint.place(torch.tensor(width, dtype=torch.float64) ** 2))
        low, share = math.floor(place), place - math.floor(place)
        blend = (1 - share) * response(footprint.width(low)) + share * response(footprint.width(low + 1))
        error = blend - response(width)
        assert float(error.abs().max()) < 0.021
        assert float(((error.square() * power).sum() / power.sum()).sqrt()) < 0.0016


def test_a_box_is_as_wide_as_light_moves_within_a_cell():
    widths = footprint.checked(0.5, -0.2, VIEWS).widths(SLOPES)
    torch.testing.assert_close(widths.abs(), torch.tensor([0.4, 0.35], dtype=torch.float64))


def test_a_map_makes_a_width_for_every_pixel():
    disparity = torch.rand(8, 9)
    cell = footprint.checked(2, disparity, VIEWS)
    assert cell.varies(SLOPES)
    torch.testing.assert_close(cell.widths(SLOPES)[0, 1], 2 * (0.5 - disparity))
    assert cell.widths(SLOPES).shape == (1, 2, 8, 9)


def test_every_light_field_may_have_a_map_of_its_own():
    disparity = torch.rand(2, 8, 9)
    widths = footprint.checked(1, disparity, VIEWS).widths(SLOPES)
    torch.testing.assert_close(widths, SLOPES.float()[:, None, None] - disparity[:, None])


@pytest.mark.parametrize(
    ("fill", "disparity", "message"),
    [
        (-1, 0.0, "fill must be finite and >= 0"),
        (math.nan, 0.0, "fill must be finite and >= 0"),
        (math.inf, 0.0, "fill must be finite and >= 0"),
        ("1", 0.0, "fill must be finite and >= 0"),
        (1, math.nan, "disparity must be finite"),
        (1, torch.full((8, 9), math.inf), "disparity must be finite"),
        (1, torch.zeros(9, 8), "disparity must be a number or a map"),
        (1, torch.zeros(3, 8, 9), "disparity must be a number or a map"),
        (1, torch.zeros(1), "disparity must be a number or a map"),
    ],
)
def test_cells_that_cannot_be_are_refused(fill, disparity, message):
    with pytest.raises(InputError, match=message):
        footprint.checked(fill, disparity, VIEWS)


def test_a_box_wider_than_the_picture_is_refused():
    with pytest.raises(InputError, match=r"at most the picture's 9 px; got 16 px"):
        footprint.checked(8, 1.0, VIEWS).widths(SLOPES)
