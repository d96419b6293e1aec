"""Samples at any position: against the definition in plain Python, and their derivatives against differences."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.autograd import gradcheck, gradgradcheck

from lfref.refocus import gather
from lfref.refocus.sampling import BORDERS, INTERPOLATIONS

LOCAL = ["nearest", "linear", "cubic"]


def sample(images, x, y, interpolation="linear", border="renormalize"):
    return gather.sample(images, x, y, INTERPOLATIONS[interpolation], BORDERS[border])


def keys(distance: float) -> float:
    """Keys' cubic kernel, a = -1/2, piece by piece as in the paper."""
    distance = abs(distance)
    if distance < 1:
        return 1.5 * distance**3 - 2.5 * distance**2 + 1
    return -0.5 * distance**3 + 2.5 * distance**2 - 4 * distance + 2 if distance < 2 else 0.0


KERNELS = {"nearest": lambda d: float(d == 0), "linear": lambda d: max(0.0, 1 - abs(d)), "cubic": keys}


def slow_sample(image: np.ndarray, x: float, y: float, interpolation: str, border: str) -> np.ndarray | None:
    """The definition: every pixel of the endless continuation of the image times the kernel; None where none is."""
    height, width = image.shape[-2:]
    if interpolation == "nearest":
        x, y = math.floor(x + 0.5), math.floor(y + 0.5)
    if border == "renormalize" and not (0 <= x <= width - 1 and 0 <= y <= height - 1):
        return None
    kernel, total = KERNELS[interpolation], np.zeros(image.shape[:-2])
    for row in range(math.floor(y) - 2, math.floor(y) + 4):
        for column in range(math.floor(x) - 2, math.floor(x) + 4):
            if border == "zero" and not (0 <= row < height and 0 <= column < width):
                continue
            if border == "wrap":
                pixel = image[..., row % height, column % width]
            else:
                pixel = image[..., min(max(row, 0), height - 1), min(max(column, 0), width - 1)]
            total += kernel(y - row) * kernel(x - column) * pixel
    return total


def doubles(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


@pytest.mark.parametrize("border", list(BORDERS))
@pytest.mark.parametrize("interpolation", LOCAL)
def test_equals_the_slow_reference_on_and_beyond_the_image(interpolation, border):
    image = torch.rand(2, 5, 7, dtype=torch.float64)
    x, y = torch.rand(60, dtype=torch.float64) * 20 - 7, torch.rand(60, dtype=torch.float64) * 16 - 6
    samples, has_sample = sample(image, x, y, interpolation, border)
    for i, (column, row) in enumerate(zip(x.tolist(), y.tolist(), strict=True)):
        slow = slow_sample(image.numpy(), column, row, interpolation, border)
        assert bool(has_sample[i]) == (slow is not None)
        if slow is not None:
            np.testing.assert_allclose(samples[:, i].numpy(), slow, atol=1e-13)


@pytest.mark.parametrize("shape", [(4,), (2, 3), (2, 1, 3)])
def test_samples_stand_where_the_positions_stand_behind_the_batch(shape):
    images = torch.rand(3, 2, 4, 5)
    x, y = torch.rand(shape, dtype=torch.float64) * 4, torch.rand(shape, dtype=torch.float64) * 3
    samples, has_sample = sample(images, x, y)
    assert samples.shape == (3, 2, *shape)
    assert samples.dtype == images.dtype
    assert has_sample.shape == shape
    torch.testing.assert_close(samples[1, 0], sample(images[1, 0], x, y)[0])


@pytest.mark.parametrize("interpolation", LOCAL)
def test_whole_positions_read_their_pixel_and_no_other(interpolation):
    image = torch.rand(5, 6, dtype=torch.float64)
    spoilt = image.clone()
    spoilt[:, 3], spoilt[2] = math.inf, math.nan
    y, x = torch.meshgrid(torch.arange(5).double(), torch.arange(6).double(), indexing="ij")
    assert torch.equal(sample(image, x, y, interpolation)[0], image)
    torch.testing.assert_close(sample(spoilt, x, y, interpolation)[0], spoilt, atol=0, rtol=0, equal_nan=True)


@given(coefficients=st.lists(st.floats(-1, 1), min_size=6, max_size=6), x=st.floats(1, 6), y=st.floats(1, 5))
def test_cubic_reproduces_quadratics_and_linear_planes(coefficients, x, y):
    def surface(x, y, terms):
        monomials = (1.0, x, y, x * y, x**2, y**2)
        return sum(c * m for c, m in zip(terms, monomials[: len(terms)], strict=True))

    columns, rows = torch.arange(8).double(), torch.arange(7).double()[:, None]
    for interpolation, n_terms in (("cubic", 6), ("linear", 4)):
        terms = coefficients[:n_terms]
        image = surface(columns, rows, terms) + torch.zeros(7, 8)
        read = sample(image, doubles(x), doubles(y), interpolation)[0]
        assert float(read) == pytest.approx(surface(x, y, terms), abs=1e-12)


@pytest.mark.parametrize("interpolation", LOCAL)
def test_rounding_takes_no_sample_from_the_outermost_pixel(interpolation):
    image = torch.arange(4, dtype=torch.float64).expand(3, 4)
    x = doubles(-1e-12, 3 + 1e-12, -0.6, 3.6)
    samples, has_sample = sample(image, x, torch.ones_like(x), interpolation)
    assert has_sample.tolist() == [True, True, False, False]
    torch.testing.assert_close(samples[:2], doubles(0, 3), atol=1e-11, rtol=0)


@pytest.mark.parametrize("interpolation", LOCAL)
def test_no_position_is_too_far(interpolation):
    image = torch.rand(4, 5, dtype=torch.float64)
    x = doubles(1e300, -1e300, math.inf, -math.inf)
    y = torch.full_like(x, 2)
    assert torch.equal(sample(image, x, y, interpolation, "edge")[0], image[2, [4, 0, 4, 0]])
    assert torch.equal(sample(image, x, y, interpolation, "zero")[0], torch.zeros_like(x))
    assert not sample(image, x, y, interpolation)[1].any()


@pytest.mark.parametrize("border", list(BORDERS))
@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_derivatives_by_images_and_positions_are_right_forwards_backwards_and_twice(interpolation, border):
    image = torch.rand(3, 4, dtype=torch.float64, requires_grad=True)
    # Away from whole pixels, where linear interpolation has a kink.
    x = doubles(-0.7, 0.3, 1.6, 3.4).requires_grad_()
    y = doubles(0.4, 1.3, 1.8, 2.6).requires_grad_()

    def read(image, x, y):
        return sample(image, x, y, interpolation, border)[0]

    assert gradcheck(read, (image, x, y), check_forward_ad=True)
    assert gradgradcheck(read, (image, x, y), check_fwd_over_rev=True, fast_mode=True)


def test_whole_positions_have_a_derivative():
    # An index that avoids the neighbour of weight 0 would freeze every slope map that starts at slope 0.
    x = doubles(2).requires_grad_()
    image = torch.arange(6, dtype=torch.float64).square().expand(4, 6)
    (linear,) = torch.autograd.grad(sample(image, x, doubles(1))[0], x)
    (cubic,) = torch.autograd.grad(sample(image, x, doubles(1), "cubic")[0], x)
    assert float(linear) == 5
    assert float(cubic) == pytest.approx(4)


@pytest.mark.parametrize("border", ["renormalize", "edge", "wrap"])
@pytest.mark.parametrize("interpolation", LOCAL)
@given(x=st.floats(-20, 20), y=st.floats(-20, 20), level=st.floats(-1e3, 1e3))
@settings(max_examples=25, deadline=None)
def test_a_constant_image_is_constant_everywhere(interpolation, border, x, y, level):
    image = torch.full((3, 4), level, dtype=torch.float64)
    samples, _ = sample(image, doubles(x), doubles(y), interpolation, border)
    assert float(samples) == pytest.approx(level, rel=1e-14)
