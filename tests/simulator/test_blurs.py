"""Blurred copies: matched variance, no change of constants, and no jump from one width to the next."""

import pytest
import torch

from lfref.functional import fourier
from lfref.simulator import blurs
from lfref.simulator.blurs import Bitmap
from lfref.simulator.canvases import Canvas
from lfref.simulator.textures import Noise

CANVAS = Canvas(-80, -80, 160, 160, (80, 80))
PIXELS = torch.arange(-19.5, 20, dtype=torch.float64)
GRID = PIXELS[None, None], PIXELS[None, :, None]


def noise():
    return Bitmap(CANVAS, Noise(exponent=1.0).painted(CANVAS, (0,)))


def box_blurred(bitmap, width):
    """The box carried out on the spectrum; the canvas holds one period of the noise."""
    gains = [torch.sinc(2 * width * f) for f in (fourier.frequencies(160)[:, None], fourier.half_frequencies(160))]
    return torch.fft.irfft2(torch.fft.rfft2(bitmap.samples.double()) * gains[0] * gains[1], s=(160, 160))


@pytest.mark.parametrize("width", [0.0, 0.3, 1.0, 2.0, 3.5, 6.0, 9.0])
def test_a_blur_is_a_box_of_that_width(width):
    bitmap = noise()
    expected = box_blurred(bitmap, width)[:, 41:121:2, 41:121:2]
    error = (bitmap.at(GRID, width)[0] - expected).square().mean()
    assert float(-10 * error.clamp(min=1e-12).log10()) > 55


def test_a_point_becomes_a_spot_of_the_boxes_variance():
    samples = torch.zeros(1, 161, 160)
    samples[:, 80, 80] = 1
    bitmap = Bitmap(Canvas(-80, -80, 160, 161, (80, 80)), samples)
    fine = torch.arange(-39, 39.5, 0.5, dtype=torch.float64)
    for width in (1.0, 2.2, 5.0, 8.7, 17.0):
        spot = bitmap.at((fine[None, None], fine[None, :, None]), width)[0, 0].sum(0).double()
        assert float(spot.sum()) == pytest.approx(1, abs=1e-5)
        assert float((spot * fine**2).sum()) == pytest.approx(width**2 / 12, rel=1e-3)


def test_blurs_go_over_into_each_other():
    bitmap = noise()
    edges = [float((n**2 - 1) ** 0.5 / 2) for n in blurs.widths()[:8].tolist()]
    for edge in edges:
        near = bitmap.at(GRID, max(edge - 1e-6, 0)), bitmap.at(GRID, edge), bitmap.at(GRID, edge + 1e-6)
        torch.testing.assert_close(near[0], near[1], atol=1e-5, rtol=0)
        torch.testing.assert_close(near[2], near[1], atol=1e-5, rtol=0)
    torch.testing.assert_close(bitmap.at(GRID, 1e-9), bitmap.at(GRID), atol=1e-7, rtol=0)


@pytest.mark.parametrize("width", [0.0, 0.7, 5.0, 70.0])
def test_a_constant_stays(width):
    bitmap = Bitmap(CANVAS, torch.full((4, 160, 160), 0.7))
    torch.testing.assert_close(bitmap.at(GRID, width), torch.full((1, 4, 40, 40), 0.7), atol=1e-6, rtol=0)


def test_copies_are_made_once():
    bitmap = noise()
    assert bitmap.copy(1) is bitmap.samples
    assert bitmap.copy(5) is bitmap.copy(5)
    assert bitmap.copy(5).shape == (3, 164, 164)


def test_points_anywhere_are_read_as_grids_are():
    bitmap = Bitmap(CANVAS, torch.rand(4, 160, 160))
    x, y = (axis.expand(1, 40, 40) for axis in GRID)
    for width in (0.0, 1.3):
        torch.testing.assert_close(bitmap.at((x, y), width), bitmap.at(GRID, width), atol=1e-6, rtol=0)
        colours = Bitmap(CANVAS, bitmap.samples[:3]).at((x, y), width)
        torch.testing.assert_close(colours, bitmap.at(GRID, width)[:, :3], atol=1e-6, rtol=0)
