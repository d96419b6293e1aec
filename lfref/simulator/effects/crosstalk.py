"""Lenslet crosstalk: light that reaches a neighbouring pixel under its lenslet ends up in the neighbouring view.

The kernel is 3 x 3 views, (a, 1 - 2a, a) along each axis. What would leave the grid stays in the outermost view, so
that energy is conserved and an even light stays even.
"""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Generator, Tensor

from lfref.simulator import checks


@dataclass(frozen=True)
class Crosstalk:
    """Neighbouring views mix."""

    name: ClassVar[str] = "crosstalk"
    needs: ClassVar[tuple[str, ...]] = ("displaced",)
    makes: ClassVar[str] = "mixed"

    leak: float = 0.0
    """Share of its light that a view gives to each neighbour along an axis, [0, 1/3]; 1/3 is the mean of the nine."""

    def __post_init__(self) -> None:
        checks.numbers("a crosstalk's leak", [self.leak], 0, 1 / 3)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """Nothing changes where nothing leaks, or there is no neighbour."""
        if not self.leak:
            return "leak is 0"
        return "a single view has no neighbour" if tuple(grid) == (1, 1) else None

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """See `mix`; nothing is drawn."""
        return mix(views, self.leak)


def mix(views: Tensor, leak: float) -> Tensor:
    """Mix every view with its neighbours.

    Args:
        views: Radiance, [V, U, C, H, W].
        leak: Share that goes to each neighbour along an axis.
    """
    rows, columns = (_exchange(n_views, leak).to(views) for n_views in views.shape[:2])
    return torch.einsum("ij,vj...->vi...", columns, torch.tensordot(rows, views, 1))


def _exchange(n_views: int, leak: float) -> Tensor:
    """Who gets how much from whom along one axis: symmetric, rows and columns of sum 1, [n_views, n_views]."""
    neighbours = torch.diag(torch.ones(n_views - 1, dtype=torch.float64), 1)
    given = leak * (neighbours + neighbours.T)
    return given + torch.diag(1 - given.sum(0))
