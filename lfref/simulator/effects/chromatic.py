"""Chromatic aberration: each colour has its own magnification (lateral) and its own focus (longitudinal).

Letters: `p q` view column and row from the angular centre, `x y` pixel from the picture's centre.
A focus of its own is a disparity that is added to that of every surface, L_c(x) = L(x - d_c p).
"""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Generator, Tensor

from lfref import geometry
from lfref.simulator import checks
from lfref.simulator.effects import resampling

Triple = tuple[float, ...]
"""One number each for red, green and blue."""


@dataclass(frozen=True)
class Chromatic:
    """Lateral and longitudinal chromatic aberration."""

    name: ClassVar[str] = "chromatic"
    needs: ClassVar[tuple[str, ...]] = ("radiance",)
    makes: ClassVar[str] = "dispersed"

    magnification: Triple = (1.0, 1.0, 1.0)
    """Size of each channel's picture, [0.5, 2]; 1 leaves it."""
    disparity: Triple = (0.0, 0.0, 0.0)
    """Added to each channel's disparities, in pixels per view step, [-10, 10]."""

    def __post_init__(self) -> None:
        checks.freeze(self)
        checks.colour("a chromatic aberration's magnification", self.magnification, 0.5, 2)
        checks.colour("a chromatic aberration's disparity", self.disparity, -10, 10)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """Nothing changes where all channels keep their size, and their focus or the only view."""
        if any(size != 1 for size in self.magnification):
            return None
        if not any(self.disparity):
            return "all colours share magnification and focus"
        return "a single view has no focus" if tuple(grid) == (1, 1) else None

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """See `disperse`; nothing is drawn."""
        return disperse(views, self.magnification, self.disparity)


def disperse(views: Tensor, magnification: Triple, disparity: Triple) -> Tensor:
    """Magnify and shift every channel on its own.

    Args:
        views: Radiance, [V, U, 3, H, W].
        magnification: About the picture's centre, above 0, [3].
        disparity: In pixels per view step, [3].
    """
    rows = _positions(views.shape[0], views.shape[-2], magnification, disparity)
    columns = _positions(views.shape[1], views.shape[-1], magnification, disparity)
    return resampling.resample(views, rows[:, None], columns)


def _positions(n_views: int, length: int, magnification: Triple, disparity: Triple) -> Tensor:
    """Where each view and channel reads along one axis, [n_views, 3, length]."""
    size, shift = (torch.tensor(values, dtype=torch.float64)[:, None] for values in (magnification, disparity))
    return (geometry.angular_offsets(length) - shift * geometry.angular_offsets(n_views)[:, None, None]) / size
