"""Blurred copies of bitmaps are boxes of matched variance."""

import numpy as np
import pytest
import torch

from lfref.functional import fourier
from lfref.simulator import bitmaps
from lfref.simulator.bitmaps import Bitmap, Canvas
from lfref.simulator.textures import Noise
from tests.simulator import eager

CANVAS = Canvas(-80, -80, 160, 160, (80, 80))


def noise():
    colours = Noise(exponent=1.0).paint(CANVAS, (0,))
    return Bitmap(CANVAS, torch.cat([colours, torch.ones(1, 160, 160)]))


def box_blurred(bitmap, width):
    """The box carried out on the spectrum; the canvas holds one period of the noise."""
    gains = [torch.sinc(2 * width * f) for f in (fourier.frequencies(160)[:, None], fourier.half_frequencies(160))]
    return torch.fft.irfft2(torch.fft.rfft2(bitmap.samples.double()) * gains[0] * gains[1], s=(160, 160))


def read(bitmap, width, i, j):
    """Linear look-ups between the two copies that stand for a blur, at columns i and rows j of the bitmap."""
    # Over all fractions alike a linear look-up has a variance of 1/6.
    (place,) = bitmaps.levels(np.array([(bitmaps.FINE * width) ** 2 / 12 - 1 / 6]))
    level = int(place)
    return torch.lerp(read_copy(bitmap, level, i, j), read_copy(bitmap, level + 1, i, j), place - level)


def read_copy(bitmap, level, i, j):
    beyond = bitmaps.margin(level)
    return eager.linear_at(bitmap.blurred(level).movedim(-1, 0), 2 * i + beyond, 2 * j + beyond)


def scattered(n=41):
    """Every pixel, at all fractions of samples alike."""
    i, j = torch.meshgrid(*2 * [torch.arange(n, dtype=torch.float64) * 2 + 40], indexing="ij")
    shares = torch.rand(2, n, n, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return i + shares[0], j + shares[1]


@pytest.mark.parametrize("width", [0.6, 1.0, 2.0, 3.5, 6.0, 9.0])
def test_a_blur_is_a_box_of_that_width(width):
    bitmap = noise()
    i, j = scattered()
    expected = eager.cubic_at(box_blurred(bitmap, width).float(), i, j)
    error = (read(bitmap, width, i, j) - expected).square().mean()
    assert float(-10 * error.log10()) > 50


@pytest.mark.parametrize("size", [1, 3, 9, 41])
@pytest.mark.parametrize("shape", [(12, 15), (3, 50)])
def test_boxes_are_means_of_what_goes_on_beyond_the_ends(size, shape):
    samples = torch.rand(*shape, 4)
    half = size - 1
    padded = torch.nn.functional.pad(samples.movedim(-1, 0)[None].double(), (half,) * 4, mode="replicate")
    expected = torch.nn.functional.avg_pool2d(padded, size, 1)[0].movedim(0, -1)
    torch.testing.assert_close(bitmaps.box_blurred(samples, size).double(), expected, atol=1e-6, rtol=0)
