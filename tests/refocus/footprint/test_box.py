import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lfref.refocus import footprint

WIDTHS = st.floats(0, 40)


def filtered(weights, frequencies):
    """What taps do to frequencies, summed up one by one."""
    middle = len(weights) // 2
    waves = (weight * torch.cos(2 * torch.pi * frequencies * (n - middle)) for n, weight in enumerate(weights))
    return sum(waves)


@pytest.mark.parametrize(("highest", "error"), [(0.2, 0.0035), (0.3, 0.009), (0.4, 0.035), (0.5, 0.18)])
def test_the_response_is_that_of_a_box(highest, error):
    frequencies = torch.linspace(0, highest, 81, dtype=torch.float64)
    for width in torch.linspace(0, 16, 641, dtype=torch.float64):
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


def test_a_point_is_the_pixel_alone():
    assert footprint.taps(0.0) == (1.0,)
    assert footprint.radius(0.0) == 0


@pytest.mark.parametrize("width", [1e-300, 1e-12, 1e-6, 1e-4])
def test_a_narrow_box_is_nearly_a_point(width):
    weights = footprint.taps(width)
    assert weights[len(weights) // 2] == pytest.approx(1, abs=width + 1e-12)
    assert all(abs(weight) <= width + 1e-12 for n, weight in enumerate(weights) if n != len(weights) // 2)


@pytest.mark.parametrize("width", [9.0, 12.4, 31.9])
def test_within_a_wide_box_all_samples_count_alike(width):
    weights = footprint.taps(width)
    inner = weights[footprint.ENDS : -footprint.ENDS]
    assert len(inner) > 0
    assert set(inner) == {1 / width}


@given(st.floats(0.01, 30))
def test_the_spread_is_that_of_a_box(width):
    weights = footprint.taps(width)
    variance = sum(weight * (n - len(weights) // 2) ** 2 for n, weight in enumerate(weights))
    assert variance == pytest.approx(width**2 / 12, rel=0.05, abs=0.03)


def test_the_response_at_whole_turns_is_zero():
    assert footprint.response(torch.tensor([5.0]), torch.tensor([0.0, 0.2, 0.1])).tolist()[0] == pytest.approx(
        [1, 0, 2 / math.pi], abs=1e-6
    )
