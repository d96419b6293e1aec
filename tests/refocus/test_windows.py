"""Gaussian local means: those of a plain sum over the window, whatever is beyond the border."""

import itertools
import math

import pytest
import torch

from lfref.functional import neighbours


def by_loops(image, sigma):
    """The mean about each pixel, tap by tap; pixels beyond the border are the nearest within."""
    half, (height, width) = math.ceil(3 * sigma), image.shape
    taps = [math.exp(-(k**2) / (2 * sigma**2)) for k in range(-half, half + 1)]
    made = torch.zeros_like(image)
    for y, x in itertools.product(range(height), range(width)):
        for (i, a), (j, b) in itertools.product(enumerate(taps, -half), repeat=2):
            made[y, x] += a * b * image[min(max(y + i, 0), height - 1), min(max(x + j, 0), width - 1)]
    return made / sum(taps) ** 2


@pytest.mark.parametrize("sigma", [0.4, 1.0, 1.5])
@pytest.mark.parametrize("size", [(6, 5), (1, 4), (1, 1)])
def test_equals_the_plain_sum(sigma, size):
    images = torch.randn(2, *size, dtype=torch.float64)
    for made, image in zip(neighbours.smoothed(images, sigma), images, strict=True):
        torch.testing.assert_close(made, by_loops(image, sigma), atol=1e-12, rtol=0)


def test_no_width_leaves_images_as_they_are():
    images = torch.randn(2, 4, 5)
    assert torch.equal(neighbours.smoothed(images, 0), images)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_level_images_stay_level_to_the_border(dtype):
    level = torch.full((3, 9, 8), 0.7, dtype=dtype)
    torch.testing.assert_close(neighbours.smoothed(level, 2.0), level)


def test_gradients_are_right():
    images = torch.randn(2, 5, 6, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: neighbours.smoothed(x, 0.8), images)
