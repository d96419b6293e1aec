"""Effects of a camera's optics: aberration, vignetting, and views that are misaligned or mix.

Chromatic aberration and misalignment move pictures, by interpolation along rows and columns.
Vignetting is falloff, cos^4 of the field angle, and the rim of the lens that clips the pupil (cat's eye). The rim is a
disc that holds every view; off the axis it is displaced, and a view keeps the share of its cell that lies within it.
Crosstalk: light that reaches a neighbouring pixel under its lenslet ends up in the neighbouring view. Its kernel is 3x3
views, (a, 1 - 2a, a) along each axis. Light that would leave the grid stays in the outermost view: energy is conserved.
Letters: `p q` view column and row from the angular centre, `x y` pixel from the picture's centre, in half diagonals of
the picture for vignetting.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Generator, Tensor

from lfref import geometry
from lfref.functional import interpolation
from lfref.simulator.effects import Effect

Size = Annotated[float, 0.5, 2]
Change = Annotated[float, -10, 10]


def resample(views: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """As `interpolation.resample`, by matrices: quicker for the small pictures here."""
    height, width = views.shape[-2:]
    return matrix(rows, height).to(views) @ views @ matrix(columns, width).to(views).mT


def matrix(positions: Tensor, length: int) -> Tensor:
    """The resampling of an axis of `length` samples at positions from the centre [..., K]: weights [..., K, length]."""
    samples, weights = interpolation.taps(positions, length)
    return torch.zeros(*positions.shape, length, dtype=positions.dtype).scatter_add_(-1, samples, weights)


@dataclass(frozen=True)
class Chromatic(Effect):
    """Chromatic aberration: each colour has its own magnification (lateral) and its own focus (longitudinal).

    Its own focus is a disparity d_c that is added to the disparity of every surface: L_c(x) = L(x - d_c p).
    """

    magnification: tuple[Size, Size, Size] = (1.0, 1.0, 1.0)  # of each channel's picture about its centre
    disparity: tuple[Change, Change, Change] = (0.0, 0.0, 0.0)
    """Number that is added to the disparities of each channel, in pixels per view step."""

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
class Vignetting(Effect):
    """Falloff towards the corners, and a pupil that is clipped there."""

    field: Annotated[float, 0, 10] = 0.0  # tangent of the field angle at the picture's corner; 0: no falloff
    cats_eye: Annotated[float, 0, 2] = 0.0
    """Displacement of the rim at the picture's corner, in radii of the rim; 0: no view is clipped."""

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Multiply by both gains."""
        return views * (falloff(views, self.field) * clipped_pupil(views, self.cats_eye))


def falloff(views: Tensor, field: float) -> Tensor:
    """cos^4 of the field angle at every pixel, a gain in (0, 1], [H, W]; `field` is its tangent at the corner."""
    x, y = _pixels(views)
    return (1 + field**2 * (x**2 + y**2)) ** -2


def clipped_pupil(views: Tensor, displacement: float) -> Tensor:
    """Share of each view's cell inside the rim, displaced by some radii at the corner, [V, U, 1, H, W]."""
    x, y = _pixels(views)
    grid = views.shape[:2]
    radius = math.hypot(*grid) / 2
    q, p = (geometry.angular_offsets(n_views).to(views) for n_views in grid)
    across = p[:, None, None, None] - displacement * radius * x
    down = q[:, None, None, None, None] - displacement * radius * y
    # A cell is one view step wide, so that its share falls from 1 to 0 over one step about the rim.
    return (radius - torch.sqrt(across**2 + down**2) + 0.5).clamp(0, 1)


def _pixels(views: Tensor) -> tuple[Tensor, Tensor]:
    """Columns [W] and rows [H, 1] in half diagonals from the centre."""
    size = views.shape[-2:]
    y, x = (geometry.angular_offsets(length) / (math.hypot(*size) / 2) for length in size)
    return x.to(views), y.to(views)[:, None]


@dataclass(frozen=True)
class Misalignment(Effect):
    """Misaligned views: a random shift for each view, normally distributed along both axes."""

    sigma: Annotated[float, 0, 10] = 0.0  # standard deviation along each axis in pixels

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Draw shifts and move the views, [V, U, C, H, W]."""
        draws = torch.randn((*views.shape[:2], 2), generator=generator).double()
        return shift(views, self.sigma * draws)


def shift(views: Tensor, shifts: Tensor) -> Tensor:
    """Move every view [V, U, C, H, W] on its own, L(x) -> L(x - dx), by (right, down) in pixels, CPU, [V, U, 2]."""
    dx, dy = shifts.double()[:, :, None, None].unbind(-1)
    height, width = views.shape[-2:]
    return resample(views, geometry.angular_offsets(height) - dy, geometry.angular_offsets(width) - dx)


@dataclass(frozen=True)
class Crosstalk(Effect):
    """Neighbouring views mix."""

    leak: Annotated[float, 0, 1 / 3] = 0.0
    """Share of its light that a view gives to each neighbour along an axis; 1/3 is the mean of the nine."""

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Mix the views, [V, U, C, H, W], along both axes."""
        shares = []  # of light between views along each axis, symmetric, rows and columns of sum 1
        for n_views in views.shape[:2]:
            neighbours = torch.diag(torch.ones(n_views - 1, dtype=torch.float64), 1)
            leaked = self.leak * (neighbours + neighbours.T)
            shares.append((leaked + torch.diag(1 - leaked.sum(0))).to(views))
        return torch.einsum("ij,vj...->vi...", shares[1], torch.tensordot(shares[0], views, 1))
