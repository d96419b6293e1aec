"""Bitmaps on surfaces: the grid that a surface is painted on, look-ups between samples, and blurred copies.

Samples lie at multiples of half a pixel from the picture's centre, so that every pixel of the central view has a sample
at its middle. Views read them by cubic convolution (Keys 1981, a = -1/2, which reproduces quadratics), which is sharp.
The truth reads blurred copies: within a cell of the aperture, a surface moves and is blurred by that distance, which
differs from pixel to pixel of a slanted surface. Each copy has a fixed box blur, and the weighted mean of two copies
has the required variance. They are read linearly, which is four times as fast as a cubic and adds a variance of up to
1/4 of a sample squared. To make up for that, the first copy is sharpened: its variance is -1/4. What is left of the
error is of the fourth order in the distance of samples. So copies have twice as many samples as the bitmap along each
axis, `FINE` per pixel: what the cubic of the views, without its overshoot, has there (`refined`).
Beyond the edge of a bitmap its outermost samples repeat.
Letters: `X Y` as in `surfaces`, `M` aperture points, `h w` rows and columns, `i j` column and row, in samples,
`t` fraction of a sample.
"""

import functools
import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.functional import splines
from lfref.functional.loops import compiled, inlined

OVERSAMPLING = 2
"""Samples per pixel along each axis. Compiled loops rely on the value 2: they keep even and odd columns apart."""
FINE = 2 * OVERSAMPLING
"""Samples per pixel along each axis of what the truth reads. At OVERSAMPLING samples, planes near focus were 61 dB from
brute force on `twigs` of sim30, however many cells they had; they are 75 dB from it at twice as many."""
TAPS = 4
"""Number of samples that a cubic reads along an axis, at -1, 0, 1 and 2 from the sample at or before the position."""
LINEAR_VARIANCE = 1 / 4
"""Variance of a linear look-up midway between samples, in samples squared."""

Floats = NDArray[np.floating]
Quadruple = tuple[np.floating, np.floating, np.floating, np.floating]
"""Weights of four samples, or red, green, blue and opacity."""
Box = tuple[float, float, float, float]
"""Left, top, right and bottom in pixels from the picture's centre."""


@dataclass(frozen=True)
class Canvas:
    """The grid of samples of a surface, as large as rays can reach."""

    left: int  # X of the first column in samples
    top: int  # Y of the first row in samples
    width: int
    height: int
    period: tuple[int, int]
    """Height and width in pixels after which random textures repeat. It does not depend on the planes of the truth."""

    @property
    def x(self) -> Tensor:
        """X of the columns in pixels, float64, [w]."""
        return torch.arange(self.left, self.left + self.width, dtype=torch.float64) / OVERSAMPLING

    @property
    def y(self) -> Tensor:
        """Y of the rows in pixels, float64, [h]."""
        return torch.arange(self.top, self.top + self.height, dtype=torch.float64) / OVERSAMPLING


def covering(box: Box, period: tuple[int, int]) -> Canvas:
    """The smallest canvas of even width that covers a box."""
    left, top = (math.floor(edge * OVERSAMPLING) for edge in box[:2])
    right, bottom = (math.ceil(edge * OVERSAMPLING) for edge in box[2:])
    # Compiled loops take the columns in pairs.
    return Canvas(left, top, (right - left) // 2 * 2 + 2, bottom - top + 1, period)


@dataclass(frozen=True, eq=False)
class Bitmap:
    """Samples on a canvas, with blurred copies of `FINE` samples per pixel that are computed on first use."""

    canvas: Canvas
    samples: Tensor  # [C, h, w]
    _blurred: dict[int, Tensor] = field(default_factory=dict)

    def window(self, size: tuple[int, int], margin: int = 0) -> Tensor:
        """The samples under the central view and a margin of pixels, each pixel's first at its middle, [C, h, w]."""
        rows, columns = (
            (torch.arange((length + 2 * margin) * OVERSAMPLING) - OVERSAMPLING * margin - (length - 1) - start).clamp(
                0, end - 1
            )
            for length, start, end in zip(
                size, (self.canvas.top, self.canvas.left), self.samples.shape[1:], strict=True
            )
        )
        return self.samples[:, rows][..., columns]

    @functools.cached_property
    def interleaved(self) -> Tensor:
        """The samples with their channels side by side, [h, w, C]."""
        return self.samples.movedim(0, -1).contiguous()

    @functools.cached_property
    def _refined(self) -> Tensor:
        """The refined samples with their channels side by side, [2h, 2w, C]."""
        return refined(self.samples).movedim(0, -1).contiguous()

    def blurred(self, level: int) -> Tensor:
        """A blurred copy of the refined samples, `margin(level)` more of them on each side, [h', w', C]."""
        if level not in self._blurred:
            samples, size = self._refined, 2 * margin(level) + 1
            self._blurred[level] = box_blurred(samples, size) if level else sharpened(samples)
        return self._blurred[level]


@functools.cache
def box_size(level: int) -> int:
    """Width in samples of the box that blurs a copy, from level 1 on: odd, about a quarter wider at each level."""
    if level == 1:
        return 1
    narrower = box_size(level - 1)
    return max(narrower + 2, 2 * round(narrower * 0.625) + 1)


def variance(level: int) -> float:
    """Variance of the blur of a copy along an axis: below 0 for level 0 (sharpened), 0 for level 1 (the samples)."""
    return (box_size(level) ** 2 - 1) / 12 if level else -LINEAR_VARIANCE


def margin(level: int) -> int:
    """Samples by which a copy is larger than its bitmap on each side."""
    return box_size(level) // 2 if level else 1


def levels(variances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Levels of the copies that have these variances along an axis, in samples squared; a fraction mixes two copies."""
    table = [variance(0)]
    while table[-1] < variances.max():
        table.append(variance(len(table)))
    return np.interp(variances, table, np.arange(len(table)))


class CopyBlur(NamedTuple):
    """Level of the blurred copy that suits each point of a slanted or curved layer, by the point's relative slope."""

    levels: NDArray[np.float64]  # level, with its fraction, at even steps of |e| from 0 on, [T]
    steps: float  # steps per unit of |e|
    nearest: float  # least |e| of all points that rays meet
    slope: float  # slope of the plane in pixels per view step

    def copies(self) -> range:
        """Levels of the copies that are read."""
        place = self.nearest * self.steps
        ends = [np.interp(place, range(len(self.levels)), self.levels), *self.levels[math.ceil(place) :]]
        return range(math.floor(min(ends)), math.ceil(max(ends)) + 1)


def refined(samples: Tensor) -> Tensor:
    """Samples [4, h, w] at half their distance, [4, 2h, 2w], as cubic look-ups read them, without overshoot."""
    for axis in (1, 2):
        index = torch.arange(samples.shape[axis])
        before, after, last = (
            samples.index_select(axis, (index + step).clamp(0, len(index) - 1)) for step in (-1, 1, 2)
        )
        # The weights of a cubic at the fraction 1/2: -1/16, 9/16, 9/16, -1/16.
        midway = (9 * (samples + after) - before - last) / 16
        samples = torch.stack([samples, midway], axis + 1).flatten(axis, axis + 1)
    return clip_premultiplied(samples)


def box_blurred(samples: Tensor, size: int) -> Tensor:
    """Means over `size` x `size` samples (odd), edge samples repeated, [h, w, C] -> [h + size - 1, w + size - 1, C]."""
    if size == 1:
        return samples
    height, width, n_channels = samples.shape
    result = torch.empty(height + size - 1, width + size - 1, n_channels, dtype=samples.dtype)
    box_mean(samples.numpy(), size, result.numpy())
    return result


@compiled
def box_mean(samples: Floats, size: int, result: Floats) -> None:
    """Means over `size` x `size` samples [h, w, C]; `result` is filled, [h + size - 1, w + size - 1, C].

    The running sums are float64, so that rounding errors do not add up. `sums` holds the sum of `size` rows for each
    column: from row to row, one row enters and one row leaves. The same is done along each row.
    """
    height, width, n_channels = samples.shape
    share = 1.0 / (size * size)
    # Above the bitmap its first row repeats.
    sums = samples[0].astype(np.float64) * size
    for row in range(result.shape[0]):
        entering, leaving = samples[min(row, height - 1)], samples[max(row - size, 0)]
        for x in range(width):
            for c in range(n_channels):
                sums[x, c] += entering[x, c] - leaving[x, c]
        for c in range(n_channels):
            total = sums[0, c] * size
            for x in range(result.shape[1]):
                total += sums[min(x, width - 1), c] - sums[max(x - size, 0), c]
                result[row, x, c] = total * share


def sharpened(samples: Tensor) -> Tensor:
    """Undo the blur of linear look-ups, of LINEAR_VARIANCE; edge samples repeat: [h, w, C] -> [h + 2, w + 2, C]."""
    for axis in (0, 1):
        length = samples.shape[axis]
        index = torch.arange(-1, length + 1)
        before, here, after = (samples.index_select(axis, (index + step).clamp(0, length - 1)) for step in (-1, 0, 1))
        # A kernel (-v/2, 1 + v, -v/2) has the sum 1 and the variance -v.
        samples = (1 + LINEAR_VARIANCE) * here - LINEAR_VARIANCE / 2 * (before + after)
    return samples


def cubic_weights(t: Tensor) -> Tensor:
    """Weights of four samples by Keys (1981), [..., 4], for fractions of a sample, [...]."""
    return torch.stack(splines.weights(t), dim=-1)


def _cubic_taps(position: Tensor, length: int) -> tuple[Tensor, Tensor]:
    """Four samples along an axis for each position, int64, [..., 4], and their weights, float32."""
    whole = position.floor()
    weights = cubic_weights((position - whole).float())
    # Clamped before the conversion: positions far outside may exceed int64.
    first = whole.clamp(-TAPS, length + TAPS).long() - 1
    return (first[..., None] + torch.arange(TAPS)).clamp(0, length - 1), weights


def cubic_on_grid(bitmap: Tensor, i: Tensor, j: Tensor) -> Tensor:
    """A bitmap [C, h, w] on grids of columns [M, 1, W] and rows [M, H, 1], axis by axis; result [M, C, H, W]."""
    rows, down = _cubic_taps(j[..., 0], bitmap.shape[-2])
    columns, across = _cubic_taps(i[:, 0], bitmap.shape[-1])
    lines = torch.zeros(())
    for tap in range(TAPS):
        lines = lines + bitmap[:, rows[..., tap]] * down[..., tap, None]
    shape = (*lines.shape[:-1], columns.shape[1])
    result = torch.zeros(())
    for tap in range(TAPS):
        result = result + lines.gather(-1, columns[:, None, :, tap].expand(shape)) * across[:, None, :, tap]
    return result.movedim(0, 1)


def clip_premultiplied(rgba: Tensor) -> Tensor:
    """Premultiplied RGBA [..., 4, H, W] without overshoot: colours are scaled down where opacity exceeds 1."""
    alpha = rgba.narrow(-3, 3, 1)
    return torch.where(alpha > 0, rgba.clamp(min=0) / alpha.clamp(min=1), 0)


@inlined
def cubic_sample(samples: Floats, start: int, rows: int, columns: int, i: float, j: float) -> Quadruple:
    """Four channels at column i and row j of a bitmap in a flat array, [rows, columns, 4], that begins at `start`."""
    column, row = np.floor(i), np.floor(j)
    across, down = _cubic_weights_of_one(np.float32(i - column)), _cubic_weights_of_one(np.float32(j - row))
    # Positions far outside are clamped while they are floats: an int would overflow.
    first, top = int(min(max(column, -4.0), columns + 4.0)) - 1, int(min(max(row, -4.0), rows + 4.0)) - 1
    c0 = c1 = c2 = c3 = np.float32(0)
    for b in range(4):
        line = start + 4 * columns * min(max(top + b, 0), rows - 1)
        for a in range(4):
            weight = across[a] * down[b]
            at = line + 4 * min(max(first + a, 0), columns - 1)
            c0 += weight * samples[at]
            c1 += weight * samples[at + 1]
            c2 += weight * samples[at + 2]
            c3 += weight * samples[at + 3]
    return c0, c1, c2, c3


@inlined
def _cubic_weights_of_one(t: np.float32) -> Quadruple:
    """`cubic_weights` of one fraction; every constant is float32, since Numba would otherwise compute in float64."""
    half, squared = np.float32(0.5), t * t
    cubed = squared * t
    return (
        squared - half * (t + cubed),
        np.float32(1) - np.float32(2.5) * squared + np.float32(1.5) * cubed,
        half * t + np.float32(2) * squared - np.float32(1.5) * cubed,
        half * (cubed - squared),
    )
