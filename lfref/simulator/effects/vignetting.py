"""Vignetting: light that falls off towards the corners, and the rim of the lens that clips the pupil (cat's eye).

Falloff is cos^4 of the field angle. The rim is a disc that holds every view; off the axis it is displaced, and a view
keeps the share of its cell that lies within the rim.
Letters: `p q` view column and row from the angular centre, `x y` pixel from the picture's centre in half diagonals of
the picture.
"""

import math
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from lfref import geometry
from lfref.simulator import checks
from lfref.simulator.effects import Effect


@dataclass(frozen=True)
class Vignetting(Effect):
    """Falloff towards the corners, and a pupil that is clipped there."""

    field: float = 0.0  # tangent of the field angle at the picture's corner, [0, 10]; 0: no falloff
    cats_eye: float = 0.0
    """Displacement of the rim at the picture's corner, in radii of the rim, [0, 2]; 0: no view is clipped."""

    def __post_init__(self) -> None:
        checks.numbers("a vignetting's field", [self.field], 0, 10)
        checks.numbers("a vignetting's cats_eye", [self.cats_eye], 0, 2)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """The effect is inert without falloff and displacement."""
        return None if self.field or self.cats_eye else "field and cat's eye are 0"

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Multiply by both gains."""
        return views * (falloff(views, self.field) * clipped_pupil(views, self.cats_eye))


def falloff(views: Tensor, field: float) -> Tensor:
    """cos^4 of the field angle at every pixel, a gain in (0, 1], [H, W].

    Only shape, type and device of the views [V, U, C, H, W] count; `field` is the tangent of the angle at the corner.
    """
    x, y = _pixels(views)
    return (1 + field**2 * (x**2 + y**2)) ** -2


def clipped_pupil(views: Tensor, displacement: float) -> Tensor:
    """Share of each view's cell that the rim lets through at every pixel, a gain in [0, 1], [V, U, 1, H, W].

    Only the shape, type and device of the views [V, U, C, H, W] count; `displacement` is the distance by which the rim
    is displaced at the corner, in radii of the rim.
    """
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
