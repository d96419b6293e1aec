"""Filters of few pixels: against PyTorch's pooling and convolution."""

import pytest
import torch
from torch.autograd import gradcheck
from torch.nn import functional as F

from lfref.functional.neighbours import binomial, box_max, box_mean

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


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("apart", [1, 2, 4])
def test_binomial_filters_read_beyond_an_edge_what_lies_at_it(size, apart):
    images = torch.rand(2, 3, *size, dtype=torch.float64)
    line = torch.zeros(2 * apart + 1, dtype=torch.float64)
    line[::apart] = torch.tensor([0.25, 0.5, 0.25])
    padded = F.pad(images, (apart,) * 4, mode="replicate")
    expected = F.conv2d(padded, (line[:, None] * line).expand(3, 1, -1, -1), groups=3)
    torch.testing.assert_close(binomial(images, apart), expected)


def test_what_is_given_stays_as_it_is():
    images = torch.rand(3, 8, 9)
    before = images.clone()
    box_mean(images, 3), box_max(images, 3), binomial(images)
    assert torch.equal(images, before)


@pytest.mark.parametrize("made", [lambda images: box_mean(images, 3), binomial])
def test_gradients(made):
    assert gradcheck(made, torch.rand(1, 4, 5, dtype=torch.float64, requires_grad=True))
