"""Bitmaps on surfaces, and their wider and wider blurred copies.

A blur is a mean of two boxes that has the wanted variance. Letters: `X Y` as in `surfaces`, `M` aperture points,
`h w` rows and columns in samples, `i j` column and row in samples.
"""

import functools
from dataclasses import dataclass, field

import torch
from torch import Tensor

from lfref.simulator import compiled, lookups
from lfref.simulator.canvases import OVERSAMPLING, Canvas

Positions = tuple[Tensor, Tensor]
"""X [M, H or 1, W] and Y [M, H, W or 1] in pixels, float64; single axes where they form a grid."""
RGBA = 4
WIDEST = 1024
"""Samples of the widest box."""


@dataclass(frozen=True, eq=False)
class Bitmap:
    """Samples on a canvas, and wider and wider blurred copies of them, made when first asked for."""

    canvas: Canvas
    samples: Tensor
    """[C, h, w]."""
    _copies: dict[int, Tensor] = field(default_factory=dict)

    def at(self, positions: Positions, blur: float = 0.0) -> Tensor:
        """What is at points of the surface.

        Args:
            positions: The points.
            blur: Width in pixels of a further box-like low-pass.

        Returns:
            [M, C, H, W].
        """
        place, share = variance_steps(blur)
        sharper = self._read(place, positions)
        return sharper if share == 0 else torch.lerp(sharper, self._read(place + 1, positions), share)

    def _read(self, place: int, positions: Positions) -> Tensor:
        size = int(widths()[place])
        x, y = positions
        i, j = x * OVERSAMPLING - self.canvas.left + size // 2, y * OVERSAMPLING - self.canvas.top + size // 2
        samples = self.copy(size)
        is_grid, on_cpu = i.shape[-2] == 1 and j.shape[-1] == 1, samples.device.type == "cpu"
        if is_grid and on_cpu and compiled.can_serve(samples, i, j):
            return compiled.on_grid(samples, i, j)
        if is_grid:
            return lookups.on_grid(samples, i, j)
        if on_cpu and len(samples) == RGBA:
            return compiled.anywhere(self._interleaved(size), i, j)
        return lookups.anywhere(samples, i, j)

    def copy(self, size: int) -> Tensor:
        """The samples, averaged over boxes of `size` (odd) samples a side."""
        if size == 1:
            return self.samples
        if size not in self._copies:
            self._copies[size] = box_blurred(self.samples, size)
        return self._copies[size]

    def _interleaved(self, size: int) -> Tensor:
        """The copy with its channels side by side, [h, w, C]; kept beside it under the size's negative."""
        if -size not in self._copies:
            self._copies[-size] = self.copy(size).movedim(0, -1).contiguous()
        return self._copies[-size]


@functools.lru_cache(maxsize=1)
def widths() -> Tensor:
    """Samples that the boxes of blurred copies span: odd, each about a quarter more than the last, int64."""
    sizes = [1]
    while sizes[-1] < WIDEST:
        sizes.append(max(sizes[-1] + 2, 2 * round(sizes[-1] * 0.625) + 1))
    return torch.tensor(sizes)


def box_blurred(bitmap: Tensor, size: int) -> Tensor:
    """Means over `size` x `size` samples, the bitmap's ends going on beyond it.

    Args:
        bitmap: [C, h, w].
        size: Odd.

    Returns:
        What is changed by it, [C, h + size - 1, w + size - 1].
    """
    return _running_mean(_running_mean(bitmap, size).mT, size).mT.contiguous()


def _running_mean(bitmap: Tensor, size: int) -> Tensor:
    ends = bitmap[..., :1].expand(*bitmap.shape[:-1], size), bitmap[..., -1:].expand(*bitmap.shape[:-1], size - 1)
    sums = torch.cat([ends[0], bitmap, ends[1]], dim=-1).double().cumsum(-1)
    return ((sums[..., size:] - sums[..., :-size]) / size).to(bitmap)


def variance_steps(blur: float) -> tuple[int, float]:
    """Which two copies stand for a blur: the mean of two boxes has the mean of their variances.

    Args:
        blur: Width of the box wanted, in pixels.

    Returns:
        Place of the narrower in `widths()`, and the wider's share.
    """
    # A box of n samples has variance (n^2 - 1) / 12.
    wanted = min((blur * OVERSAMPLING) ** 2, float(widths()[-1]) ** 2 - 1)
    variances = (widths() ** 2 - 1).double()
    place = min(int(torch.searchsorted(variances, wanted, right=True)) - 1, len(variances) - 2)
    low, high = variances[place : place + 2].tolist()
    return place, (wanted - low) / (high - low)
