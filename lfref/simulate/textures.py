"""Random textures and mattes, smooth enough to be shifted by fractions of a pixel with hardly any error.

All are periodic on their canvas and come from a `torch.Generator`, so that a seed fixes them.
"""

import torch
from torch import Generator, Tensor

SOFTNESS = 0.75  # pixels: standard deviation of the blur that ends the spectrum of hard-edged textures, without ringing
TAPER = 0.35  # cycles per pixel where textures start to fade out; they end before Nyquist


def power_noise(generator: Generator, shape: tuple[int, int, int], exponent: float) -> Tensor:
    """Noise with spectrum 1/f^exponent, like natural images at exponents near 1 to 2.

    Args:
        generator: Source of randomness.
        shape: Channels, height and width.
        exponent: Fall of the amplitude with frequency; larger is smoother.

    Returns:
        Zero mean, unit standard deviation, float32, [C, H, W].
    """
    channels, height, width = shape
    radius = _radius(height, width)
    gain = radius.clamp(min=1 / max(height, width)) ** -exponent
    fade = ((0.5 - radius) / (0.5 - TAPER)).clamp(0, 1)
    white = torch.randn(channels, height, width, generator=generator)
    spectrum = torch.fft.rfft2(white) * gain * fade * (radius > 0)
    noise = torch.fft.irfft2(spectrum, s=(height, width))
    return noise / noise.std(dim=(-2, -1), keepdim=True)


def colours(generator: Generator, height: int, width: int) -> Tensor:
    """A coloured surface: a base colour, a shared pattern with or without hard edges, and a little colour noise.

    Args:
        generator: Source of randomness.
        height: Rows in pixels.
        width: Columns in pixels.

    Returns:
        Radiance in [0, 1], float32, [3, H, W].
    """
    base, tint = torch.rand(2, 3, 1, 1, generator=generator)
    contrast, hardness, exponent = torch.rand(3, generator=generator).tolist()
    pattern = power_noise(generator, (1, height, width), 1 + exponent)
    pattern = torch.tanh(pattern * (0.5 + 4 * hardness**2))
    grain = power_noise(generator, (3, height, width), 1.0)
    surface = 0.15 + 0.7 * base + (0.15 + 0.35 * contrast) * pattern * (0.5 + tint) / 1.5 + 0.03 * grain
    return _softened(surface.clamp(0, 1)).clamp(0, 1)


def toned(colour: Tensor, saturation: float) -> Tensor:
    """A surface with less of its colour.

    Args:
        colour: Radiance in [0, 1], [3, H, W].
        saturation: 1 keeps it, 0 leaves grey.
    """
    grey = colour.mean(dim=0, keepdim=True)
    return grey + saturation * (colour - grey)


def blobs(generator: Generator, height: int, width: int, share: float) -> Tensor:
    """A matte of irregular islands whose edges are about two pixels wide.

    Args:
        generator: Source of randomness.
        height: Rows in pixels.
        width: Columns in pixels.
        share: Part of the canvas that the islands cover, in (0, 1).

    Returns:
        Opacity in [0, 1], float32, [1, H, W].
    """
    relief = power_noise(generator, (1, height, width), 2.2)
    level = torch.quantile(relief.flatten(), 1 - share)
    rows, columns = torch.gradient(relief[0])
    slope = (rows**2 + columns**2).sqrt().clamp(min=1e-3)
    step = ((relief - level) / slope / 2 + 0.5).clamp(0, 1)
    return step * step * (3 - 2 * step)


def _radius(height: int, width: int) -> Tensor:
    """Frequency of each bin of `rfft2` in cycles per pixel, [H, W // 2 + 1]."""
    return (torch.fft.fftfreq(height)[:, None] ** 2 + torch.fft.rfftfreq(width) ** 2).sqrt()


def _softened(image: Tensor) -> Tensor:
    height, width = image.shape[-2:]
    gain = torch.exp(-2 * (torch.pi * SOFTNESS * _radius(height, width)) ** 2)
    return torch.fft.irfft2(torch.fft.rfft2(image) * gain, s=(height, width))
