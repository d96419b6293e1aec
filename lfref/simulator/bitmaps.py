"""Bitmaps on surfaces, and their wider and wider blurred copies.

The truth blurs a surface by the way it moves within a cell of the aperture, a different width at each pixel of a
slanted surface. Such a blur is a mean of two copies with fixed box blurs, weighted so that it has the wanted variance.
Copies are read linearly, which blurs by itself, by up to 1/4 of a sample squared; the first copy is sharpened by as
much, so that variances go on below 0.
Letters: `X Y` as in `surfaces`, `M` aperture points, `h w` rows and columns, `i j` column and row, in samples.
"""

import functools
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.functional.jit import compiled
from lfref.simulator import lookups
from lfref.simulator.canvases import OVERSAMPLING, Canvas
from lfref.simulator.lookups import Floats

Positions = tuple[Tensor, Tensor]
"""X [M, H or 1, W] and Y [M, H, W or 1] in pixels, float64; single axes where they form a grid."""
WIDEST = 1024
"""Samples of the widest box at least: 512 pixels, the blur of a whole picture."""
LINEAR_VARIANCE = 1 / 4
"""Variance of a linear look-up midway between samples, in samples squared."""


@dataclass(frozen=True, eq=False)
class Bitmap:
    """Samples on a canvas, with blurred copies that are computed on first use."""

    canvas: Canvas
    samples: Tensor
    """[C, h, w]."""
    _blurred: dict[int, Tensor] = field(default_factory=dict)

    def at(self, positions: Positions) -> Tensor:
        """The bitmap at points of the surface, by cubic look-ups, [M, C, H, W]."""
        x, y = positions
        i, j = x * OVERSAMPLING - self.canvas.left, y * OVERSAMPLING - self.canvas.top
        read = lookups.cubic_on_grid if i.shape[-2] == j.shape[-1] == 1 else lookups.cubic_at
        return read(self.samples, i, j)

    def window(self, size: tuple[int, int], margin: int = 0) -> Tensor:
        """The samples under the H x W pixels of the central view and a margin of pixels around it.

        The first of each pixel's samples is at its middle; ends of the bitmap go on beyond it.
        Result: [C, OVERSAMPLING (H + 2 margin), OVERSAMPLING (W + 2 margin)].
        """
        rows, columns = (
            (torch.arange((length + 2 * margin) * OVERSAMPLING) - OVERSAMPLING * margin - (length - 1) - start)
            .clamp(0, end - 1)
            .to(self.samples.device)
            for length, start, end in zip(
                size, (self.canvas.top, self.canvas.left), self.samples.shape[1:], strict=True
            )
        )
        return self.samples[:, rows][..., columns]

    @functools.cached_property
    def interleaved(self) -> Tensor:
        """The samples with their channels side by side, [h, w, C]."""
        return self.samples.movedim(0, -1).contiguous()

    def blurred(self, level: int) -> Tensor:
        """A blurred copy, larger than the bitmap by `margin(level)` samples on each side, [h', w', C]."""
        if level not in self._blurred:
            samples, size = self.interleaved, 2 * margin(level) + 1
            self._blurred[level] = box_blurred(samples, size) if level else sharpened(samples)
        return self._blurred[level]

    def to(self, device: torch.device) -> "Bitmap":
        """The bitmap on a device."""
        return Bitmap(self.canvas, self.samples.to(device))


@functools.lru_cache(maxsize=1)
def box_sizes() -> tuple[int, ...]:
    """Widths of the boxes of blurred copies in samples: odd, each about a quarter more than the last."""
    sizes = [1]
    while sizes[-1] < WIDEST:
        sizes.append(max(sizes[-1] + 2, 2 * round(sizes[-1] * 0.625) + 1))
    return tuple(sizes)


@functools.lru_cache(maxsize=1)
def variances() -> NDArray[np.float64]:
    """Variance along an axis of each level: the sharpened copy, the samples, and wider and wider boxes."""
    return np.array([-LINEAR_VARIANCE, *((size**2 - 1) / 12 for size in box_sizes())])


def margin(level: int) -> int:
    """Samples by which a copy is larger than its bitmap on each side."""
    return box_sizes()[level - 1] // 2 if level else 1


def levels(variance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Level of each blur, with a fraction between two copies, from its variance along an axis in samples squared."""
    return np.interp(variance, variances(), np.arange(len(variances())))


def box_blurred(samples: Tensor, size: int) -> Tensor:
    """Means over `size` x `size` samples (odd), the ends going on, [h, w, C] -> [h + size - 1, w + size - 1, C]."""
    if samples.device.type == "cpu" and size > 1:
        height, width, n_channels = samples.shape
        result = torch.empty(height + size - 1, width + size - 1, n_channels, dtype=samples.dtype)
        box_mean(samples.numpy(), size, result.numpy())
        return result
    return _running_mean(_running_mean(samples, size, 0), size, 1)


@compiled
def box_mean(samples: Floats, size: int, result: Floats) -> None:
    """Means over `size` x `size` samples [h, w, C]; `result` is filled, [h + size - 1, w + size - 1, C].

    Running sums, in float64 so that rounding does not add up: `sums` holds the sum of `size` rows for each column. It
    changes by one row that enters and one that leaves; the same is done along the row.
    """
    height, width, n_channels = samples.shape
    share = 1.0 / (size * size)
    # Above the bitmap all rows are its first one.
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


def _running_mean(samples: Tensor, size: int, axis: int) -> Tensor:
    """The same along one axis by PyTorch, for other devices."""
    if size == 1:
        return samples
    length = samples.shape[axis]
    index = torch.arange(-size, length + size - 1, device=samples.device).clamp(0, length - 1)
    sums = samples.index_select(axis, index).double().cumsum(axis)
    return ((sums.narrow(axis, size, length + size - 1) - sums.narrow(axis, 0, length + size - 1)) / size).to(samples)


def sharpened(samples: Tensor) -> Tensor:
    """Samples of variance -LINEAR_VARIANCE along each axis, the ends going on, [h, w, C] -> [h + 2, w + 2, C]."""
    for axis in (0, 1):
        length = samples.shape[axis]
        index = torch.arange(-1, length + 1, device=samples.device)
        before, here, after = (samples.index_select(axis, (index + step).clamp(0, length - 1)) for step in (-1, 0, 1))
        samples = (1 + LINEAR_VARIANCE) * here - LINEAR_VARIANCE / 2 * (before + after)
    return samples
