"""The grid that a surface is painted on: twice as fine as the central view, and as large as is ever seen of it.

Samples lie at multiples of half a pixel from the picture's centre, on pixels of the central view among others.
Letters: `X Y` as in `surfaces`, `h w` height and width in samples.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

OVERSAMPLING = 2
"""Samples a pixel, along each axis."""

Box = tuple[float, float, float, float]
"""Left, top, right and bottom in pixels from the picture's centre."""


@dataclass(frozen=True)
class Canvas:
    """A grid of samples on a surface."""

    left: int
    """X of the first column, in samples."""
    top: int
    """Y of the first row, in samples."""
    width: int
    """Columns."""
    height: int
    """Rows."""
    period: tuple[int, int]
    """Height and width in pixels after which random textures repeat; the same whatever else is asked for."""

    @property
    def x(self) -> Tensor:
        """X of the columns in pixels, float64, [w]."""
        return torch.arange(self.left, self.left + self.width, dtype=torch.float64) / OVERSAMPLING

    @property
    def y(self) -> Tensor:
        """Y of the rows in pixels, float64, [h]."""
        return torch.arange(self.top, self.top + self.height, dtype=torch.float64) / OVERSAMPLING


def covering(box: Box, period: tuple[int, int]) -> Canvas:
    """The canvas that covers a box.

    Args:
        box: In pixels from the picture's centre.
        period: As in `Canvas`.
    """
    left, top = (math.floor(edge * OVERSAMPLING) for edge in box[:2])
    right, bottom = (math.ceil(edge * OVERSAMPLING) for edge in box[2:])
    # An even width: compiled loops take the columns in pairs.
    return Canvas(left, top, (right - left) // 2 * 2 + 2, bottom - top + 1, period)


def intersection(one: Box, other: Box) -> Box:
    """What two boxes have in common; a point if that is nothing."""
    left, top = max(one[0], other[0]), max(one[1], other[1])
    return left, top, max(left, min(one[2], other[2])), max(top, min(one[3], other[3]))


def fast_length(length: float) -> int:
    """The next even length whose Fourier transform is quick: a product of 2, 3 and 5."""
    candidate = 2 * math.ceil(max(length, 2) / 2)
    while _rest(candidate) > 1:
        candidate += 2
    return candidate


def _rest(number: int) -> int:
    for factor in (2, 3, 5):
        while number % factor == 0:
            number //= factor
    return number
