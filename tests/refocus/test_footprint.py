"""Cells of the aperture: taps of a box against its response, levels of widths, and what is refused."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.refocus import footprint
from lfref.refocus.footprint import RowFactors
from lfref.refocus.sampling import BORDERS


def taps_of(width):
    """Taps of one box, as numbers."""
    return footprint.taps(torch.tensor([width], dtype=torch.float64), footprint.radius(width))[0].tolist()


def boxed(planes, width, border):
    """Planes [..., C, H, W] blurred by one box, by PyTorch."""
    taps = footprint.taps(torch.tensor([width], dtype=torch.float64), footprint.radius(width))
    return footprint.boxed(planes[..., None, :, :, :], taps, BORDERS[border])[..., 0, :, :, :]


def filtered(weights, frequencies):
    """What taps do to frequencies, summed up one by one."""
    middle = len(weights) // 2
    waves = (weight * torch.cos(2 * torch.pi * frequencies * (n - middle)) for n, weight in enumerate(weights))
    return sum(waves)


@pytest.mark.parametrize(("highest", "error"), [(0.2, 0.0035), (0.3, 0.009), (0.4, 0.035), (0.5, 0.18)])
def test_the_response_is_that_of_a_box(highest, error):
    frequencies = torch.linspace(0, highest, 81, dtype=torch.float64)
    for width in torch.linspace(0, 16, 161, dtype=torch.float64):
        weights = taps_of(float(width))
        assert sum(weights) == pytest.approx(1, abs=1e-12)
        assert float((filtered(weights, frequencies) - torch.sinc(width * frequencies)).abs().max()) < error


def slow_box(image, widths, border):
    """Each pixel's own box, one sample at a time; [H, W] each."""
    height, width = image.shape
    blurred = torch.zeros_like(image)
    for y in range(height):
        for x in range(width):
            weights = taps_of(float(widths[y, x]))
            radius = len(weights) // 2
            for k, down in enumerate(weights):
                for m, across in enumerate(weights):
                    blurred[y, x] += down * across * read(image, y + k - radius, x + m - radius, border)
    return blurred


def read(image, y, x, border):
    height, width = image.shape
    if border == "wrap":
        return image[y % height, x % width]
    inside = 0 <= y < height and 0 <= x < width
    if border in ("zero", "renormalize") and not inside:
        return 0.0
    return image[min(max(y, 0), height - 1), min(max(x, 0), width - 1)]


@pytest.mark.parametrize("border", list(BORDERS))
@pytest.mark.parametrize("width", [0.0, 0.3, 1.0, 2.7, 13.0])
def test_equals_the_slow_reference(border, width):
    images = torch.rand(2, 7, 9, dtype=torch.float64)
    blurred = boxed(images, width, border)
    for image, result in zip(images, blurred, strict=True):
        slow = slow_box(image, torch.full((7, 9), width, dtype=torch.float64), border)
        torch.testing.assert_close(result, slow, atol=1e-12, rtol=0)


def boxed_numba(stack, widths, border):
    height, width = stack.shape[-2:]
    kinds = np.arange(height)
    ones = np.ones((height, width), stack.numpy().dtype)
    scales = [RowFactors(ones, kinds) for _ in widths]
    blurred = stack.clone()
    footprint.box_planes(blurred.numpy(), widths, BORDERS[border], scales)
    return blurred


@settings(deadline=None, max_examples=40)
@given(
    height=st.integers(1, 20),
    width=st.integers(1, 40),
    box=st.floats(0, 25),
    border=st.sampled_from(list(BORDERS)),
)
def test_equals_eager_at_any_size(height, width, box, border):
    stack = torch.rand(1, 1, 1, height, width, dtype=torch.float64)
    expected = boxed(stack, box, border)
    torch.testing.assert_close(boxed_numba(stack, [box], border), expected, atol=1e-12, rtol=0)
