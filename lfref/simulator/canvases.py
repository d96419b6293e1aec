"""The grid that a surface is painted on: twice as fine as the pixels of the central view, as large as rays can reach.

Samples lie at multiples of half a pixel from the picture's centre, so that every pixel of the central view has one.
Letters: `X Y` as in `surfaces`, `h w` height and width in samples.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

OVERSAMPLING = 2
"""Samples per pixel along each axis. Compiled loops rely on it: they keep even and odd columns apart."""

Box = tuple[float, float, float, float]
"""Left, top, right and bottom in pixels from the picture's centre."""


@dataclass(frozen=True)
class Canvas:
    """A grid of samples on a surface."""

    left: int
    """X of the first column in samples."""
    top: int
    """Y of the first row in samples."""
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


def intersection(one: Box, other: Box) -> Box:
    """The part that two boxes share; a point where they do not overlap."""
    left, top = max(one[0], other[0]), max(one[1], other[1])
    return left, top, max(left, min(one[2], other[2])), max(top, min(one[3], other[3]))


def fast_length(length: float) -> int:
    """The next even length with a fast Fourier transform: a product of 2, 3 and 5."""
    candidate = 2 * math.ceil(max(length, 2) / 2)
    # Every product of 2, 3 and 5 up to 2^60 divides 30^60.
    while pow(30, 60, candidate):
        candidate += 2
    return candidate
