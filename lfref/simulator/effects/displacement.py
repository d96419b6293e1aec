"""Effects that move pictures: chromatic aberration and misaligned views, by interpolation along rows and columns.

Pictures are read between their samples by Lagrange interpolation through eight samples. It reproduces polynomials of
degree 7, and the samples themselves at whole positions; beyond the edge, the outermost sample repeats.
Source: Laakso et al., "Splitting the unit delay", 1996.
Letters: `p q` view column and row from the angular centre, `x y` pixel from the picture's centre.
"""

import math
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from lfref import geometry
from lfref.simulator import checks
from lfref.simulator.effects import Effect

TAPS = range(-3, 5)
"""Samples around a position, counted from the sample at or before it."""
Triple = tuple[float, ...]
"""One number each for red, green and blue."""


def weights(t: Tensor) -> Tensor:
    """Lagrange's weights of the samples `TAPS`, [..., 8], for fractions t of a sample in [0, 1), [...]."""
    one = torch.ones_like(t)
    products = [math.prod(((t - other) / (tap - other) for other in TAPS if other != tap), start=one) for tap in TAPS]
    return torch.stack(products, -1)


def matrix(positions: Tensor, length: int) -> Tensor:
    """The resampling of one axis as a matrix: weight of each of `length` samples at each position, [..., K, length].

    Positions [..., K] are in pixels from the centre, float64 like the matrix.
    """
    index = (positions + (length - 1) / 2).clamp(0, length - 1)
    whole = index.floor()
    taps = whole.long()[..., None] + torch.tensor(TAPS)
    empty = torch.zeros(*positions.shape, length, dtype=positions.dtype)
    return empty.scatter_add_(-1, taps.clamp(0, length - 1), weights(index - whole))


def resample(views: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Views [V, U, C, H, W] read at other rows and columns, in pixels from the centre, float64, CPU.

    Rows are [..., H] and columns [..., W], their leading axes broadcast with [V, U, C].
    """
    height, width = views.shape[-2:]
    return matrix(rows, height).to(views) @ views @ matrix(columns, width).to(views).mT


@dataclass(frozen=True)
class Chromatic(Effect):
    """Chromatic aberration: each colour has its own magnification (lateral) and its own focus (longitudinal).

    Its own focus is a disparity d_c that is added to the disparity of every surface: L_c(x) = L(x - d_c p).
    """

    magnification: Triple = (1.0, 1.0, 1.0)
    """Size of each channel's picture about its centre, [0.5, 2]; 1 keeps it."""
    disparity: Triple = (0.0, 0.0, 0.0)
    """Number that is added to each channel's disparities, in pixels per view step, [-10, 10]."""

    def __post_init__(self) -> None:
        checks.freeze(self)
        checks.colour("a chromatic aberration's magnification", self.magnification, 0.5, 2)
        checks.colour("a chromatic aberration's disparity", self.disparity, -10, 10)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """The effect is inert if every magnification is 1, and every added disparity is 0 or there is only one view."""
        if any(size != 1 for size in self.magnification):
            return None
        if not any(self.disparity):
            return "all colours share magnification and focus"
        return "a single view has no focus" if tuple(grid) == (1, 1) else None

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Magnify and shift every channel of the views [V, U, 3, H, W]."""
        size, focus = (
            torch.tensor(value, dtype=torch.float64)[:, None] for value in (self.magnification, self.disparity)
        )
        # Position that each view and channel reads along each axis, [V or U, 3, H or W].
        rows, columns = (
            (geometry.angular_offsets(length) - focus * geometry.angular_offsets(n_views)[:, None, None]) / size
            for n_views, length in zip(views.shape[:2], views.shape[-2:], strict=True)
        )
        return resample(views, rows[:, None], columns)


@dataclass(frozen=True)
class Misalignment(Effect):
    """Misaligned views: a random shift for each view, normally distributed along both axes."""

    sigma: float = 0.0  # standard deviation along each axis in pixels, [0, 10]

    def __post_init__(self) -> None:
        checks.numbers("a misalignment's sigma", [self.sigma], 0, 10)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """The effect is inert if all shifts are 0."""
        return None if self.sigma else "sigma is 0"

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Draw shifts and move the views, [V, U, C, H, W]."""
        draws = torch.randn((*views.shape[:2], 2), generator=generator).double()
        return shift(views, self.sigma * draws)


def shift(views: Tensor, shifts: Tensor) -> Tensor:
    """Move every view [V, U, C, H, W] on its own, L(x) -> L(x - dx), by (right, down) in pixels, CPU, [V, U, 2]."""
    dx, dy = shifts.double()[:, :, None, None].unbind(-1)
    height, width = views.shape[-2:]
    return resample(views, geometry.angular_offsets(height) - dy, geometry.angular_offsets(width) - dx)
