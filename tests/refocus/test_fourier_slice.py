import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.errors import InputError
from lfref.refocus.exact_fourier import exact_fourier
from lfref.refocus.fourier_slice import fourier_slice


def decibels(image: torch.Tensor, reference: torch.Tensor) -> float:
    return -10 * math.log10((image - reference).square().mean().item() + 1e-30)


@pytest.mark.parametrize("disparity", [-1.7, 0.3, 1.0])
@pytest.mark.parametrize(("height", "width"), [(48, 51), (49, 50)])
@pytest.mark.parametrize(
    ("options", "owed"),
    [
        ({"kernel": "linear", "padding": 1}, 25),
        ({"kernel": "linear", "padding": 2}, 35),
        ({"kernel": "kaiser_bessel", "width": 4, "padding": 2}, 70),
        ({"kernel": "kaiser_bessel", "width": 6, "padding": 2}, 110),
    ],
)
def test_accuracy_on_a_textured_plane_in_focus(plane, disparity, height, width, options, owed):
    views, _ = plane(disparity, height, width)
    sliced, exact = fourier_slice(views, [disparity], **options), exact_fourier(views, [disparity])
    assert decibels(sliced, exact) > owed


@pytest.mark.parametrize("grid", [(4, 7), (5, 6)])
@pytest.mark.parametrize(("height", "width"), [(16, 18), (15, 16)])
def test_even_and_odd_grids_and_sizes_agree_with_exact(grid, height, width):
    # White noise: full energy at Nyquist.
    views = torch.rand(*grid, 2, height, width, dtype=torch.float64)
    slopes = [-1.3, 0.0, 0.8]
    torch.testing.assert_close(fourier_slice(views, slopes, width=8), exact_fourier(views, slopes), atol=1e-7, rtol=0)


@pytest.mark.parametrize(
    ("kernel", "width", "padding"),
    [("linear", 2, 1), ("linear", 2, 2), ("kaiser_bessel", 4, 2), ("kaiser_bessel", 5, 1.5)],
)
@given(slope=st.floats(-3, 3))
@settings(max_examples=10, deadline=None)
def test_dc_gain_is_1(kernel, width, padding, slope):
    stack = fourier_slice(torch.ones(7, 7, 1, 20, 21), [slope], kernel, width, padding)
    assert abs(stack.mean().item() - 1) < 1e-3


def test_float32_keeps_the_accuracy():
    views = torch.rand(7, 7, 1, 33, 40, dtype=torch.float64)
    error = fourier_slice(views.float(), [0.7]).double() - fourier_slice(views, [0.7])
    assert error.abs().max() < 2e-6


def test_weights_choose_the_views():
    views = torch.rand(3, 3, 1, 12, 13, dtype=torch.float64)
    weights = torch.rand(3, 3)
    sliced, exact = fourier_slice(views, [0.6], width=8, weights=weights), exact_fourier(views, [0.6], weights)
    torch.testing.assert_close(sliced, exact, atol=1e-6, rtol=0)


def test_gradients_are_right():
    views = torch.rand(2, 3, 1, 4, 5, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: fourier_slice(x, [0.4]), views)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kernel": "cubic"}, "kernel must be one of"),
        ({"padding": 0.5}, "padding"),
        ({"padding": float("nan")}, "padding"),
        ({"width": 1}, "width >= 2"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        fourier_slice(torch.rand(3, 3, 1, 10, 10), [0.5], **options)
