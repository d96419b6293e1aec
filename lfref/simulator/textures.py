"""Textures: colours of surfaces, painted on a canvas and band-limited to what pixels can record without aliasing.

Textures have no frequencies at or above half a cycle per pixel. Fejer's weights remove the higher harmonics of waves
without overshoot. Noise and pictures are made on the grid of pixels and interpolated to the finer canvas with the
response cos^2(pi f) along each axis, which is 1/2 at a quarter of a cycle per pixel and 0 at half a cycle.
Letters: `X Y` as in `surfaces`, `h w` rows and columns of the canvas, `f` frequency in cycles per pixel.
"""

import abc
import functools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
from torch import Tensor

from lfref.io import images
from lfref.simulator import checks
from lfref.simulator.bitmaps import OVERSAMPLING, Canvas

NYQUIST = 0.5
"""Cycles per pixel at which the spectra of all textures end."""
HARMONICS = 0.35
"""Highest frequency of a wave's harmonics, in cycles per pixel. The product of a checker's two waves reaches sqrt 2
times as far along a diagonal: from harmonics below 1/sqrt 8 = 0.354, it still ends below NYQUIST."""
GREY = (0.5, 0.5, 0.5)

Colour = tuple[checks.Share, checks.Share, checks.Share]
"""Red, green and blue reflectance."""


class Texture(checks.Description, abc.ABC):
    """Colours of a surface."""

    @abc.abstractmethod
    def paint(self, canvas: Canvas, key: tuple[int, ...]) -> Tensor:
        """Colours from 0 to 1 on a canvas, float32, CPU, [3, h, w]; the numbers of `key` fix all randomness."""


@dataclass(frozen=True)
class Flat(Texture):
    """One colour."""

    colour: Colour = GREY

    def paint(self, canvas: Canvas, key: tuple[int, ...] = ()) -> Tensor:
        """The colour."""
        return torch.tensor(self.colour)[:, None, None].expand(3, canvas.height, canvas.width)


@dataclass(frozen=True)
class _Wave(Texture):
    """Two colours that alternate along one direction or two."""

    lengths = ("period",)
    period: checks.Positive  # period in pixels
    low: Colour = (0.2, 0.2, 0.2)  # first colour
    high: Colour = (0.8, 0.8, 0.8)  # second colour
    angle: float = 0.0  # direction of the wave in degrees, from x towards y
    phase: float = 0.0  # phase in periods

    def _mix(self, wave: Tensor) -> Tensor:
        """Colours of a wave from -1, the first colour, to 1, the second one."""
        low, high = (torch.tensor(colour)[:, None, None] for colour in (self.low, self.high))
        return low + (high - low) * (0.5 + 0.5 * wave).float()

    def _cycles(self, canvas: Canvas, turn: float) -> Tensor:
        """Periods since the start of the wave along its direction, which is turned by `turn` degrees, [h, w]."""
        angle = math.radians(self.angle + turn)
        return (canvas.x * math.cos(angle) + canvas.y[:, None] * math.sin(angle)) / self.period + self.phase


@dataclass(frozen=True)
class Gradient(_Wave):
    """A cosine from one colour to the other and back."""

    def paint(self, canvas: Canvas, key: tuple[int, ...] = ()) -> Tensor:
        """The cosine; its mean colour if the period is too short for pixels to record."""
        amplitude = 1.0 if self.period * NYQUIST > 1 else 0.0
        return self._mix(-amplitude * torch.cos(2 * torch.pi * self._cycles(canvas, 0)))


@dataclass(frozen=True)
class Stripes(_Wave):
    """Stripes half a period wide."""

    def paint(self, canvas: Canvas, key: tuple[int, ...] = ()) -> Tensor:
        """A square wave."""
        return self._mix(_square_wave(self._cycles(canvas, 0), self.period))


@dataclass(frozen=True)
class Checker(_Wave):
    """Squares half a period wide."""

    def paint(self, canvas: Canvas, key: tuple[int, ...] = ()) -> Tensor:
        """The product of two square waves."""
        along, across = (_square_wave(self._cycles(canvas, turn), self.period) for turn in (0, 90))
        return self._mix(along * across)


def _square_wave(cycles: Tensor, period: float) -> Tensor:
    """A band-limited square wave between -1 and 1, read from a table."""
    table = _wave_table(math.floor(HARMONICS * period))
    n_samples = len(table) - 1
    position = (cycles - cycles.floor()) * n_samples
    below = position.long().clamp(max=n_samples - 1)
    return torch.lerp(table[below], table[below + 1], (position - below).to(table))


@functools.lru_cache(maxsize=64)
def _wave_table(n_harmonics: int) -> Tensor:
    """One period of a square wave with Fejer's weights, and its first sample again."""
    phase = torch.linspace(0, 2 * torch.pi, 4097, dtype=torch.float64)
    wave = torch.zeros_like(phase)
    for n in range(1, n_harmonics + 1, 2):
        wave += (1 - n / (n_harmonics + 1)) * 4 / (torch.pi * n) * torch.sin(n * phase)
    return wave.float()


@dataclass(frozen=True)
class Noise(Texture):
    """A random pattern of spectrum 1/f^exponent with soft or hard edges between two colours, and fine colour noise."""

    colour: Colour = GREY  # mean colour
    contrast: Colour = (0.3, 0.3, 0.3)  # amplitude of the pattern
    exponent: Annotated[float, 0, 4] = 1.5  # fall of the amplitude with frequency; larger is smoother
    hardness: checks.Share = 0.2  # from 0 (smooth) to 1 (patches with edges)
    grain: checks.Share = 0.02  # standard deviation of the colour noise

    def paint(self, canvas: Canvas, key: tuple[int, ...]) -> Tensor:
        """The pattern: tanh of a noise, steeper for harder edges."""
        random = np.random.Generator(np.random.SFC64(key))
        pattern = torch.tanh(_random_tile(random, 1, canvas.period, self.exponent) * (0.5 + 4 * self.hardness**2))
        contrast, mean = (torch.tensor(values)[:, None, None] for values in (self.contrast, self.colour))
        tile = mean + contrast * pattern + self.grain * _random_tile(random, 3, canvas.period, 1.0)
        return _tiled(oversampled(tile.clamp(0, 1)), canvas).clamp(0, 1)


@dataclass(frozen=True)
class Picture(Texture):
    """An image file in the middle of the surface, mirrored again and again beyond its edges."""

    lengths = ("width",)
    path: str  # PNG, EXR, TIFF or JPEG; grey or colour
    width: Annotated[float, 4, 16384] = 256.0  # width in pixels of the central view

    def paint(self, canvas: Canvas, key: tuple[int, ...] = ()) -> Tensor:
        """The image; a missing or damaged file raises FileError."""
        image = torch.from_numpy(images.to_float(images.read_image(Path(self.path)))).movedim(-1, 0)
        image = image[:3] if len(image) > 2 else image[:1].expand(3, -1, -1)
        size = [max(2, round(length * self.width / image.shape[-1])) for length in image.shape[-2:]]
        options = {"mode": "bicubic", "align_corners": False, "antialias": True}
        small = torch.nn.functional.interpolate(image[None], size, **options)[0].clamp(0, 1)  # type: ignore[arg-type]
        # Together with its mirror image, the picture is periodic without a jump.
        wide = torch.cat([small, small.flip(-1)], dim=-1)
        tile = oversampled(torch.cat([wide, wide.flip(-2)], dim=-2))
        # A tile starts in the picture's centre: turn it so that the middle of the image lies there, not its corner.
        return _tiled(tile.roll((1 - size[0], 1 - size[1]), (-2, -1)), canvas).clamp(0, 1)


def _random_tile(random: np.random.Generator, n_channels: int, size: tuple[int, int], exponent: float) -> Tensor:
    """Periodic noise of spectrum 1/f^exponent, mean 0 and deviation 1, float32, [n_channels, *size]."""
    shape = (n_channels, size[0], size[1] // 2 + 1, 2)
    spectrum = torch.view_as_complex(torch.from_numpy(random.standard_normal(shape, np.float32)))
    frequency = torch.hypot(torch.fft.fftfreq(size[0])[:, None], torch.fft.rfftfreq(size[1]))
    frequency[0, 0] = torch.inf  # no mean
    noise = torch.fft.irfft2(spectrum * frequency**-exponent, s=size)
    return noise / noise.square().mean(dim=(-2, -1), keepdim=True).sqrt()


def oversampled(tile: Tensor) -> Tensor:
    """A periodic tile of pixels, [C, H, W] of even size, on the canvas's grid, [C, OVERSAMPLING H, OVERSAMPLING W]."""
    height, width = tile.shape[-2:]
    spectrum = torch.fft.rfft2(tile) * _response(height, width)
    half = height // 2
    padded = spectrum.new_zeros(*spectrum.shape[:-2], height * OVERSAMPLING, width // 2 + 1)
    padded[..., :half, :], padded[..., -half:, :] = spectrum[..., :half, :], spectrum[..., half:, :]
    # Columns first: `irfft` pads the rows itself, and the columns that it adds are 0.
    columns = torch.fft.ifft(padded, dim=-2)
    return torch.fft.irfft(columns, n=width * OVERSAMPLING, dim=-1) * OVERSAMPLING**2


@functools.lru_cache(maxsize=16)
def _response(height: int, width: int) -> Tensor:
    """cos^2(pi f) along both axes at the bins of `rfft2`."""
    rows = torch.cos(torch.pi * torch.fft.fftfreq(height)) ** 2
    return rows[:, None] * torch.cos(torch.pi * torch.fft.rfftfreq(width)) ** 2


def _tiled(tile: Tensor, canvas: Canvas) -> Tensor:
    """A canvas covered with a tile that starts at the picture's centre."""
    rows = torch.arange(canvas.top, canvas.top + canvas.height) % tile.shape[-2]
    columns = torch.arange(canvas.left, canvas.left + canvas.width) % tile.shape[-1]
    return tile.index_select(-2, rows).index_select(-1, columns)
