import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lfref.refocus import footprint


@given(st.integers(0, 40))
def test_a_level_lies_at_its_own_width(level):
    place = footprint.place(torch.tensor(footprint.width(level), dtype=torch.float64).square())
    assert float(place) == pytest.approx(level, abs=1e-9)


def test_level_0_is_a_point():
    assert footprint.width(0) == 0


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
