"""psnr.py: against skimage and a high-precision oracle, and finite where the paper's form is not."""

import math

import mpmath
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.metrics import peak_signal_noise_ratio

from lfref.errors import InputError
from lfref.functional.psnr import CEILING_DB, inverse_psnr, inverse_psnr_of_mse, mse, psnr
from tests.functional.test_ssim import images

JOIN = math.exp(-2)
FLOOR = 1e-10


def slope_at(m: float) -> float:
    point = torch.tensor(m, dtype=torch.float64, requires_grad=True)
    inverse_psnr_of_mse(point).backward()
    return point.grad.item()


@pytest.mark.parametrize("size", [1e-45, 1e-30, 1e19, 3e38])
def test_mse_survives_differences_whose_float32_square_does_not(size: float) -> None:
    prediction = torch.full((1, 4, 4), size)
    assert mse(prediction, torch.zeros(1, 4, 4)).item() == pytest.approx(prediction[0, 0, 0].item() ** 2, rel=1e-12)


@pytest.mark.parametrize("data_range", [1.0, 255.0])
def test_psnr_agrees_with_skimage(data_range: float) -> None:
    prediction, target = (data_range * images(3, 16, 16, seed=seed, dtype=torch.float64) for seed in (0, 1))
    expected = peak_signal_noise_ratio(target.numpy(), prediction.numpy(), data_range=data_range)
    assert psnr(prediction, target, data_range).item() == pytest.approx(expected, abs=1e-12)


def test_psnr_of_identical_images_is_the_ceiling_with_gradient_zero() -> None:
    prediction = images(3, 8, 8).requires_grad_()
    value = psnr(prediction, prediction.detach().clone())
    value.backward()
    assert value.item() == CEILING_DB == 100.0
    assert (prediction.grad == 0).all()


@pytest.mark.parametrize("function", [psnr, inverse_psnr])
@pytest.mark.parametrize(
    ("given_type", "returned"),
    [
        (torch.float16, torch.float32),
        (torch.bfloat16, torch.float32),
        (torch.float32, torch.float32),
        (torch.float64, torch.float64),
    ],
)
def test_results_are_float32_or_the_wider_input_type(function, given_type, returned) -> None:
    value = function(images(2, 3, 4, 4, dtype=given_type), images(2, 3, 4, 4, seed=1, dtype=given_type))
    assert value.dtype == returned
    assert value.shape == (2,)


def test_inverse_psnr_is_the_papers_form_from_8_69_to_100_decibels() -> None:
    with mpmath.workdps(50):
        for decibel in np.linspace(8.6859, 100, 400):
            m = float(10 ** (-decibel / 10))
            oracle = 1 / (-10 * mpmath.log10(mpmath.mpf(m)))
            value = inverse_psnr_of_mse(torch.tensor(m, dtype=torch.float64)).item()
            assert abs(value - float(oracle)) < 1e-15


@pytest.mark.parametrize("join", [FLOOR, JOIN])
def test_inverse_psnr_joins_its_tangents_in_value_and_slope(join: float) -> None:
    left, middle, right = (join * (1 + step) for step in (-1e-6, 0, 1e-6))
    values = inverse_psnr_of_mse(torch.tensor([left, middle, right], dtype=torch.float64))
    assert values.diff().abs().max() < 1e-5 * values[1]
    expected = math.log(10) / 10 / (join * math.log(join) ** 2)
    for point in (left, middle, right):
        assert slope_at(point) == pytest.approx(expected, rel=1e-5)


def test_inverse_psnr_has_a_continuous_second_derivative_at_its_upper_join() -> None:
    step = 1e-4
    inside = (slope_at(JOIN) - slope_at(JOIN - step)) / step
    outside = (slope_at(JOIN + step) - slope_at(JOIN)) / step
    assert abs(inside - outside) < 1e-3 * slope_at(JOIN) / JOIN


def test_inverse_psnr_grows_with_the_error_over_36_decades() -> None:
    m = torch.logspace(-30, 6, 20001, dtype=torch.float64)
    values = inverse_psnr_of_mse(m)
    assert (values > 0).all()
    assert (values.diff() >= 0).all()
    # Strictly, as far as float64 resolves the steps of the tangent near 0.
    assert (values[m > 1e-20].diff() > 0).all()


@pytest.mark.parametrize("m", [0.0, 5e-324, 1e-30, 1e-10, 1e-5, JOIN, 0.999999, 1.0, 1.000001, 2.0, 1e6, 1e300])
def test_inverse_psnr_has_a_finite_positive_value_and_slope_everywhere(m: float) -> None:
    value = inverse_psnr_of_mse(torch.tensor(m, dtype=torch.float64)).item()
    assert math.isfinite(value)
    assert value > 0
    assert math.isfinite(slope_at(m))
    assert slope_at(m) > 0


@given(st.floats(1e-3, 1e5), st.integers(0, 100))
@settings(max_examples=25, deadline=None)
def test_scaling_images_and_range_together_changes_nothing(data_range: float, seed: int) -> None:
    x, y = (images(3, 6, 6, dtype=torch.float64, seed=2 * seed + odd) for odd in (0, 1))
    for function in (psnr, inverse_psnr):
        torch.testing.assert_close(function(x * data_range, y * data_range, data_range), function(x, y))
        assert torch.equal(function(x, y), function(y, x))


@pytest.mark.parametrize(
    ("prediction", "target", "options"),
    [
        (torch.rand(1, 8, 8), torch.rand(3, 8, 8), {}),
        (torch.rand(8, 8), torch.rand(8, 8), {}),
        (torch.ones(3, 8, 8, dtype=torch.uint8), torch.rand(3, 8, 8), {}),
        (torch.rand(3, 8, 8), torch.rand(3, 8, 8), {"data_range": 0.0}),
    ],
)
def test_images_and_options_that_cannot_be_used_are_refused(prediction, target, options) -> None:
    with pytest.raises(InputError):
        inverse_psnr(prediction, target, **options)
