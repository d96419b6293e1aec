"""Blurred copies: means of boxes, matched variance, no change of constants, no jump between widths."""

import numpy as np
import pytest
import torch

from lfref.functional import fourier
from lfref.simulator import bitmaps, lookups
from lfref.simulator.bitmaps import Bitmap
from lfref.simulator.canvases import Canvas
from lfref.simulator.textures import Noise

CANVAS = Canvas(-80, -80, 160, 160, (80, 80))


def noise():
    return Bitmap(CANVAS, Noise(exponent=1.0).paint(CANVAS, (0,)))


def box_blurred(bitmap, width):
    """The box carried out on the spectrum; the canvas holds one period of the noise."""
    gains = [torch.sinc(2 * width * f) for f in (fourier.frequencies(160)[:, None], fourier.half_frequencies(160))]
    return torch.fft.irfft2(torch.fft.rfft2(bitmap.samples.double()) * gains[0] * gains[1], s=(160, 160))


def read(bitmap, width, i, j):
    """Linear look-ups between the two copies that stand for a blur."""
    # Over all fractions alike a linear look-up has a variance of 1/6.
    (place,) = bitmaps.levels(np.array([(2 * width) ** 2 / 12 - 1 / 6]))
    level = int(place)
    parts = []
    for n in (level, level + 1):
        parts.append(lookups.linear_at(bitmap.blurred(n).movedim(-1, 0), i + bitmaps.margin(n), j + bitmaps.margin(n)))
    return torch.lerp(parts[0], parts[1], place - level)


def scattered(n=41):
    """Every pixel, at all fractions of samples alike."""
    i, j = torch.meshgrid(*2 * [torch.arange(n, dtype=torch.float64) * 2 + 40], indexing="ij")
    shares = torch.rand(2, n, n, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return i + shares[0], j + shares[1]


@pytest.mark.parametrize("width", [0.6, 1.0, 2.0, 3.5, 6.0, 9.0])
def test_a_blur_is_a_box_of_that_width(width):
    bitmap = noise()
    i, j = scattered()
    expected = lookups.cubic_at(box_blurred(bitmap, width).float(), i, j)
    error = (read(bitmap, width, i, j) - expected).square().mean()
    assert float(-10 * error.log10()) > 50


def test_the_sharpened_copy_undoes_what_linear_look_ups_blur_midway():
    bitmap = noise()
    i, j = scattered()
    i, j = i.floor() + 0.5, j.floor() + 0.5
    exact = lookups.cubic_at(bitmap.samples, i, j)
    errors = [
        (lookups.linear_at(bitmap.blurred(level).movedim(-1, 0), i + beyond, j + beyond) - exact).square().mean()
        for level, beyond in ((0, 1), (1, 0))
    ]
    assert float(errors[0]) < 0.1 * float(errors[1])


@pytest.mark.parametrize("size", [1, 3, 9, 41])
@pytest.mark.parametrize("shape", [(12, 15), (3, 50)])
def test_boxes_are_means_of_what_goes_on_beyond_the_ends(size, shape):
    samples = torch.rand(*shape, 4)
    half = size - 1
    padded = torch.nn.functional.pad(samples.movedim(-1, 0)[None].double(), (half,) * 4, mode="replicate")
    expected = torch.nn.functional.avg_pool2d(padded, size, 1)[0].movedim(0, -1)
    torch.testing.assert_close(bitmaps.box_blurred(samples, size).double(), expected, atol=1e-6, rtol=0)
    eager = bitmaps._running_mean(bitmaps._running_mean(samples, size, 0), size, 1)
    torch.testing.assert_close(eager.double(), expected, atol=1e-6, rtol=0)


def test_variances_are_those_of_the_copies():
    point = torch.zeros(1, 61, 60)
    point[:, 30, 30] = 1
    bitmap = Bitmap(Canvas(-30, -30, 60, 61, (30, 30)), point)
    for level, variance in enumerate(bitmaps.variances()[:7]):
        spot = bitmap.blurred(level)[..., 0].sum(0).double()
        places = torch.arange(len(spot)) - 30 - bitmaps.margin(level)
        assert float((spot * places**2).sum()) == pytest.approx(variance, abs=1e-5)


def test_levels_go_up_with_the_width_without_a_jump():
    places = bitmaps.levels(np.linspace(0, 60, 2000) ** 2 / 12 - bitmaps.LINEAR_VARIANCE)
    assert places[0] == 0
    assert 0 <= np.diff(places).min() <= np.diff(places).max() < 0.1


@pytest.mark.parametrize("width", [0.0, 0.7, 5.0, 70.0])
def test_a_constant_stays(width):
    bitmap = Bitmap(CANVAS, torch.full((4, 160, 160), 0.7))
    i, j = scattered()
    torch.testing.assert_close(read(bitmap, width, i, j), torch.full((4, 41, 41), 0.7), atol=1e-6, rtol=0)


@pytest.mark.parametrize("size", [3, 5, 11])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_each_sample_is_the_mean_of_a_box(size, kind):
    samples = np.random.default_rng(0).random((6, 8, 4)).astype(kind)
    result = np.empty((6 + size - 1, 8 + size - 1, 4), kind)
    bitmaps.box_mean(samples, size, result)
    padded = np.pad(samples, ((size - 1,) * 2, (size - 1,) * 2, (0, 0)), mode="edge")
    for row in range(result.shape[0]):
        for column in range(result.shape[1]):
            expected = padded[row : row + size, column : column + size].mean((0, 1))
            np.testing.assert_allclose(result[row, column], expected, atol=1e-6)
