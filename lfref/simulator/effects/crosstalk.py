"""Lenslet crosstalk: light that reaches a neighbouring pixel under its lenslet ends up in the neighbouring view.

The kernel is 3 x 3 views, (a, 1 - 2a, a) along each axis. Light that would leave the grid stays in the outermost view,
so that energy is conserved and uniform light stays uniform.
"""

from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from lfref.simulator import checks
from lfref.simulator.effects import Effect


@dataclass(frozen=True)
class Crosstalk(Effect):
    """Neighbouring views mix."""

    leak: float = 0.0
    """Share of its light that a view gives to each neighbour along an axis, [0, 1/3]; 1/3 is the mean of the nine."""

    def __post_init__(self) -> None:
        checks.numbers("a crosstalk's leak", [self.leak], 0, 1 / 3)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """The effect is inert without a leak or a neighbour."""
        if not self.leak:
            return "leak is 0"
        return "a single view has no neighbour" if tuple(grid) == (1, 1) else None

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Mix the views, [V, U, C, H, W], along both axes."""
        rows, columns = (_exchange(n_views, self.leak).to(views) for n_views in views.shape[:2])
        return torch.einsum("ij,vj...->vi...", columns, torch.tensordot(rows, views, 1))


def _exchange(n_views: int, leak: float) -> Tensor:
    """Shares of light between views along one axis: symmetric, rows and columns of sum 1, [n_views, n_views]."""
    neighbours = torch.diag(torch.ones(n_views - 1, dtype=torch.float64), 1)
    leaked = leak * (neighbours + neighbours.T)
    return leaked + torch.diag(1 - leaked.sum(0))
