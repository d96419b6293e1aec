"""View misalignment: every view sits a random fraction of a pixel beside its place."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Generator, Tensor

from lfref import geometry
from lfref.simulator import checks
from lfref.simulator.effects import resampling
from lfref.simulator.effects.effect import normal


@dataclass(frozen=True)
class Misalignment:
    """Normally distributed shifts, one for each view."""

    name: ClassVar[str] = "misalignment"
    needs: ClassVar[tuple[str, ...]] = ("vignetted",)
    makes: ClassVar[str] = "displaced"

    sigma: float = 0.0
    """Standard deviation along each axis in pixels, [0, 10]."""

    def __post_init__(self) -> None:
        checks.numbers("a misalignment's sigma", [self.sigma], 0, 10)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """Nothing changes where the shifts are 0."""
        return None if self.sigma else "sigma is 0"

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """See `shift`; its shifts are drawn."""
        draws = normal((*views.shape[:2], 2), generator, torch.zeros((), dtype=torch.float64))
        return shift(views, self.sigma * draws)


def shift(views: Tensor, shifts: Tensor) -> Tensor:
    """Move every view on its own, L(x) -> L(x - dx).

    Args:
        views: Radiance, [V, U, C, H, W].
        shifts: To the right and down in pixels, CPU, [V, U, 2].
    """
    dx, dy = shifts.double()[:, :, None, None].unbind(-1)
    height, width = views.shape[-2:]
    return resampling.resample(views, geometry.angular_offsets(height) - dy, geometry.angular_offsets(width) - dx)
