"""Textures stay in [0, 1], end before Nyquist, and come from their key alone."""

import pytest
import torch

from lfref.io import images
from lfref.simulator.bitmaps import Canvas
from lfref.simulator.textures import Checker, Flat, Gradient, Noise, Picture, Stripes

CANVAS = Canvas(-64, -60, 128, 120, (60, 64))
TEXTURES = [
    Flat((0.1, 0.5, 1.0)),
    Gradient(150.0, angle=30.0),
    Checker(10.0),
    Checker(7.3, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 25.0, 0.3),
    Stripes(4.0, (0.0, 0.1, 0.2), (1.0, 0.9, 0.8), 70.0),
    Noise(),
    Noise((0.1, 0.5, 0.9), (0.9, 0.9, 0.9), 1.0, 1.0, 0.1),
]


def aliased_share(image):
    """Part of the power at or above half a cycle a pixel along either axis; the window's own leakage is below 1e-6."""
    height, width = image.shape[-2:]
    window = torch.hann_window(height, dtype=torch.float64)[:, None] ** 2 * torch.hann_window(width) ** 2
    centred = (image.double() - image.double().mean((-2, -1), keepdim=True)) * window
    power = torch.fft.fft2(centred).abs().square().sum(0)
    rows, columns = (torch.fft.fftfreq(length).abs() * 2 for length in (height, width))
    above = (rows[:, None] > 0.53) | (columns > 0.53)
    return float(power[above].sum() / power.sum().clamp(min=1e-12))


@pytest.mark.parametrize("texture", TEXTURES[1:])
def test_pixels_sample_them_without_aliasing(texture):
    assert aliased_share(texture.paint(CANVAS, (1, 2))) < 1e-5


@pytest.mark.parametrize("texture", TEXTURES)
def test_the_key_fixes_the_colours_and_a_larger_canvas_shows_the_same(texture):
    colours = texture.paint(CANVAS, (1, 2))
    assert -1e-6 <= float(colours.min()) <= float(colours.max()) <= 1 + 1e-6
    torch.manual_seed(5)
    assert torch.equal(colours, texture.paint(CANVAS, (1, 2)))
    larger = texture.paint(Canvas(-74, -68, 148, 136, CANVAS.period), (1, 2))
    torch.testing.assert_close(larger[:, 8:-8, 10:-10], colours, atol=1e-6, rtol=0)


def test_a_picture_lies_in_the_middle_pixel_on_pixel(tmp_path):
    y, x = torch.meshgrid(torch.arange(40.0), torch.arange(48.0), indexing="ij")
    image = torch.stack([x / 47, y / 39, 0.5 + 0.3 * torch.sin(x / 6)])
    images.write_image(tmp_path / "image.exr", image.movedim(0, -1).numpy())
    # Pixel (0, 0) of a picture of 40 x 48 is 19.5 and 23.5 px from the centre.
    painted = Picture(str(tmp_path / "image.exr"), 48.0).paint(Canvas(-47, -39, 96, 80, (40, 48)))
    torch.testing.assert_close(painted[:, ::2, ::2][:, 2:-2, 2:-2], image[:, 2:-2, 2:-2], atol=6e-3, rtol=0)
