"""Filters of few pixels: against PyTorch's pooling and convolution, and a plain sum."""

import itertools
import math

import pytest
import torch
from torch.autograd import gradcheck
from torch.nn import functional as F

from lfref.functional import neighbours
from lfref.functional.neighbours import box_max, box_mean

SIZES = [(1, 1), (3, 2), (8, 9), (31, 40)]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("window", [1, 3, 5, 9])
def test_box_means_are_means_of_what_lies_within_the_picture(size, window):
    images = torch.rand(2, 3, *size, dtype=torch.float64)
    expected = F.avg_pool2d(images, window, 1, window // 2, count_include_pad=False)
    torch.testing.assert_close(box_mean(images, window), expected)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("window", [1, 3, 5, 15, 33])
def test_the_largest_is_that_of_what_lies_within_the_picture(size, window):
    images = torch.randn(2, 3, *size)
    assert torch.equal(box_max(images, window), F.max_pool2d(images, window, 1, window // 2))


@pytest.mark.parametrize("made", [lambda images: box_mean(images, 3), lambda images: neighbours.smoothed(images, 0.8)])
def test_gradients(made):
    assert gradcheck(made, torch.rand(1, 4, 5, dtype=torch.float64, requires_grad=True))


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
