"""Textures stay in [0, 1], have the spectrum they claim, and come from their seed alone."""

import pytest
import torch
from torch import Generator

from lfref.simulate import textures


def generator(seed=0):
    return Generator().manual_seed(seed)


def radius(height, width):
    return (torch.fft.fftfreq(height)[:, None] ** 2 + torch.fft.fftfreq(width) ** 2).sqrt()


def power(image):
    """Spectral power of each channel without its mean, [C, H, W]."""
    centred = image.double() - image.double().mean((-2, -1), keepdim=True)
    return torch.fft.fft2(centred).abs().square()


@pytest.mark.parametrize("shape", [(1, 32, 32), (3, 31, 40), (2, 64, 9)])
@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.2])
def test_noise_has_no_mean_and_unit_deviation(shape, exponent):
    noise = textures.power_noise(generator(), shape, exponent)
    assert noise.shape == shape
    assert noise.dtype == torch.float32
    torch.testing.assert_close(noise.mean((-2, -1)), torch.zeros(shape[0]), atol=1e-5, rtol=0)
    torch.testing.assert_close(noise.std((-2, -1)), torch.ones(shape[0]), atol=1e-5, rtol=0)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0])
def test_noise_ends_before_nyquist(exponent):
    spectrum = power(textures.power_noise(generator(), (1, 64, 61), exponent))[0]
    assert spectrum[radius(64, 61) >= 0.5].sum() < 1e-12 * spectrum.sum()


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_the_amplitude_of_noise_falls_as_the_power_of_the_frequency(exponent):
    spectrum = power(textures.power_noise(generator(), (24, 96, 96), exponent)).mean(0)
    r = radius(96, 96)
    band = (r > 0.05) & (r < 0.34)
    logs = torch.stack([r[band].double().log(), torch.ones(int(band.sum()), dtype=torch.float64)], dim=1)
    slope = torch.linalg.lstsq(logs, spectrum[band].log()[:, None]).solution[0, 0]
    assert float(slope) == pytest.approx(-2 * exponent, abs=0.1)


@pytest.mark.parametrize("make", [textures.colours, lambda g, h, w: textures.blobs(g, h, w, 0.3)])
def test_the_seed_fixes_the_texture_and_nothing_else_does(make):
    first = make(generator(5), 24, 27)
    torch.manual_seed(123)
    torch.rand(3)
    assert torch.equal(first, make(generator(5), 24, 27))
    assert not torch.allclose(first, make(generator(6), 24, 27))


@pytest.mark.parametrize("seed", range(8))
def test_colours_are_radiance_with_something_to_see(seed):
    colour = textures.colours(generator(seed), 48, 50)
    assert colour.shape == (3, 48, 50)
    assert colour.min() >= 0
    assert colour.max() <= 1
    assert (colour.std((-2, -1)) > 0.01).all()


def test_colours_are_band_limited():
    for seed in range(8):
        spectrum = power(textures.colours(generator(seed), 96, 96))
        assert spectrum[:, radius(96, 96) >= 0.5].sum() < 1e-4 * spectrum.sum()


@pytest.mark.parametrize("share", [0.1, 0.35, 0.7])
def test_islands_cover_their_share(share):
    matte = textures.blobs(generator(), 96, 90, share)
    assert matte.shape == (1, 96, 90)
    assert matte.min() == 0
    assert matte.max() == 1
    assert float(matte.mean()) == pytest.approx(share, abs=0.02)
    assert float((matte > 0.5).float().mean()) == pytest.approx(share, abs=0.01)


def test_islands_have_edges_about_two_pixels_wide():
    matte = textures.blobs(generator(), 128, 128, 0.3)[0]
    rows, columns = torch.gradient(matte)
    steepest = (rows**2 + columns**2).sqrt()
    # A smooth step over two pixels has slope 3/4 in its middle; central differences see a little less.
    assert 0.4 < float(steepest.quantile(0.995)) < 0.76
    between = float(((matte > 0.01) & (matte < 0.99)).float().mean())
    outline = float(((matte[1:] > 0.5) != (matte[:-1] > 0.5)).float().mean())
    outline += float(((matte[:, 1:] > 0.5) != (matte[:, :-1] > 0.5)).float().mean())
    # Steps across rows and columns count a contour of random direction 4/pi times its length.
    assert 1.3 < between / (outline * torch.pi / 4) < 2.3
