"""The compiled loop of box blurs: running sums over rows, then along them."""

import functools
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.functional.jit import compiled
from lfref.simulator import lookups
from lfref.simulator.canvases import OVERSAMPLING, Canvas

Reals = NDArray[np.floating]


@compiled
def box_mean(samples: Reals, size: int, result: Reals) -> None:
    """Means over `size` x `size` samples, the ends going on beyond them.

    Args:
        samples: [h, w, C].
        size: Odd.
        result: Filled, [h + size - 1, w + size - 1, C].
    """
    height = samples.shape[0]
    sums = samples[0].astype(np.float64) * size
    for row in range(result.shape[0]):
        added, dropped = samples[min(row, height - 1)], samples[max(row - size, 0)]
        _replace(sums, added, dropped)
        _means_along(sums, size, result[row])


@compiled
def _replace(sums: Reals, added: Reals, dropped: Reals) -> None:
    for x in range(sums.shape[0]):
        for c in range(sums.shape[1]):
            sums[x, c] += added[x, c] - dropped[x, c]


@compiled
def _means_along(sums: Reals, size: int, row: Reals) -> None:
    width, share = sums.shape[0], 1.0 / (size * size)
    for c in range(sums.shape[1]):
        total = sums[0, c] * size
        for x in range(row.shape[0]):
            total += sums[min(x, width - 1), c] - sums[max(x - size, 0), c]
            row[x, c] = total * share


# PART blurs
# Bitmaps on surfaces, and their wider and wider blurred copies.
#
# A blur is a mean of two copies that has the variance wanted. Copies are read linearly, which blurs by itself, by up to
# 1/4 of a sample squared; the first copy is sharpened by as much, so that variances go on below 0.
# Letters: `X Y` as in `surfaces`, `M` aperture points, `h w` rows and columns, `i j` column and row, in samples.

Positions = tuple[Tensor, Tensor]
"""X [M, H or 1, W] and Y [M, H, W or 1] in pixels, float64; single axes where they form a grid."""
WIDEST = 1024
"""Samples of the widest box."""
LINEAR = 1 / 4
"""Variance of a linear look-up midway between samples."""


@dataclass(frozen=True, eq=False)
class Bitmap:
    """Samples on a canvas, and wider and wider blurred copies of them, made when first asked for."""

    canvas: Canvas
    samples: Tensor
    """[C, h, w]."""
    _copies: dict[int, Tensor] = field(default_factory=dict)

    def at(self, positions: Positions) -> Tensor:
        """What is at points of the surface.

        Args:
            positions: The points.

        Returns:
            [M, C, H, W].
        """
        x, y = positions
        i, j = x * OVERSAMPLING - self.canvas.left, y * OVERSAMPLING - self.canvas.top
        read = lookups.on_grid if i.shape[-2] == j.shape[-1] == 1 else lookups.anywhere
        return read(self.samples, i, j)

    def window(self, size: tuple[int, int], margin: int = 0) -> Tensor:
        """The samples that belong to the pixels of the central view, its ends going on beyond it.

        Args:
            size: Height and width (H, W) of the view in pixels.
            margin: Pixels around it.

        Returns:
            The first of each pixel's samples is at its middle, [C, OVERSAMPLING (H + 2 margin), likewise of W].
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

    def copy(self, level: int) -> Tensor:
        """A blurred copy.

        Args:
            level: Place in `variances()`.

        Returns:
            Channels side by side; beyond the bitmap by `margin(level)` samples on each side, [h', w', C].
        """
        if level not in self._copies:
            samples, size = self.interleaved, 2 * margin(level) + 1
            self._copies[level] = box_blurred(samples, size) if level else sharpened(samples)
        return self._copies[level]

    def to(self, device: torch.device) -> "Bitmap":
        """The bitmap on a device."""
        return Bitmap(self.canvas, self.samples.to(device))


@functools.lru_cache(maxsize=1)
def variances() -> NDArray[np.float64]:
    """Variance of all copies along an axis, in samples squared: of one sharpened, the samples, and wider boxes."""
    return np.array([-LINEAR, *((size**2 - 1) / 12 for size in sizes())])


@functools.lru_cache(maxsize=1)
def sizes() -> tuple[int, ...]:
    """Samples that the boxes of blurred copies span: odd, each about a quarter more than the last."""
    found = [1]
    while found[-1] < WIDEST:
        found.append(max(found[-1] + 2, 2 * round(found[-1] * 0.625) + 1))
    return tuple(found)


def margin(level: int) -> int:
    """Samples by which a copy goes beyond its bitmap on each side."""
    return sizes()[level - 1] // 2 if level else 1


def levels(variance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Between which copies a blur lies.

    Args:
        variance: Along an axis, in samples squared.

    Returns:
        Places in `variances()` with fractions, of the same shape.
    """
    return np.interp(variance, variances(), np.arange(len(variances())))


def box_blurred(samples: Tensor, size: int) -> Tensor:
    """Means over `size` x `size` samples, the ends going on beyond them.

    Args:
        samples: [h, w, C].
        size: Odd.

    Returns:
        What is changed by it, [h + size - 1, w + size - 1, C].
    """
    if samples.device.type == "cpu" and size > 1:
        height, width, n_channels = samples.shape
        result = torch.empty(height + size - 1, width + size - 1, n_channels, dtype=samples.dtype)
        box_mean(samples.numpy(), size, result.numpy())
        return result
    return _running_mean(_running_mean(samples, size, 0), size, 1)


def _running_mean(samples: Tensor, size: int, axis: int) -> Tensor:
    if size == 1:
        return samples
    length = samples.shape[axis]
    places = torch.arange(-size, length + size - 1, device=samples.device).clamp(0, length - 1)
    sums = samples.index_select(axis, places).double().cumsum(axis)
    return ((sums.narrow(axis, size, length + size - 1) - sums.narrow(axis, 0, length + size - 1)) / size).to(samples)


def sharpened(samples: Tensor) -> Tensor:
    """Samples of variance -`LINEAR` along each axis, the ends going on beyond them, [h, w, C] -> [h + 2, w + 2, C]."""
    return _sharpened(_sharpened(samples, 0), 1)


def _sharpened(samples: Tensor, axis: int) -> Tensor:
    length = samples.shape[axis]
    places = torch.arange(-1, length + 1, device=samples.device)
    before, here, after = (samples.index_select(axis, (places + step).clamp(0, length - 1)) for step in (-1, 0, 1))
    return (1 + LINEAR) * here - LINEAR / 2 * (before + after)
