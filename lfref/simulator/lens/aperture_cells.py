"""The aperture of a lens cut into cells: where each lies, how much of it is open, how many are needed.

An aperture spans the views' cells, U x V view steps; a disc is the ellipse inscribed. Cells are of one size and as
nearly square as whole numbers of them allow.
Letters: `p q` aperture column and row in view steps, `U V` its width and height, `j i` row and column of cells.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from lfref.functional import cells
from lfref.simulator.scene import Camera

CELLS_PER_ROOT = {"square": 1.2, "disc": 2.0}
"""Cells a side for a blur of 1 px beside the first one; they grow with its root. A disc's edge is not that of cells."""


@dataclass(frozen=True)
class Aperture:
    """The opening of a lens."""

    shape: str
    """`square` or `disc`."""
    height: float
    """V in view steps."""
    width: float
    """U in view steps."""

    @property
    def extent(self) -> float:
        """The longer side in view steps."""
        return max(self.height, self.width)


@dataclass(frozen=True, eq=False)
class Cells:
    """A grid of cells that covers an aperture."""

    p: Tensor
    """Columns of cell centres in view steps, float64, [I]."""
    q: Tensor
    """Rows of cell centres in view steps, float64, [J]."""
    weights: Tensor
    """Share of the open aperture that each cell holds, of sum 1, float64, [J, I]."""
    height: float
    """Of one cell in view steps."""
    width: float
    """Of one cell in view steps."""


def aperture(camera: Camera) -> Aperture:
    """The aperture of a camera: the cells of its views."""
    return Aperture(camera.aperture, *map(float, camera.grid))


def cut(whole: Aperture, n_cells: int) -> Cells:
    """Cut an aperture into cells.

    Args:
        whole: The aperture.
        n_cells: Cells along its longer side, at least 1.

    Returns:
        The cells, those that are shut included.
    """
    sides = (whole.height, whole.width)
    counts = [max(1, math.ceil(n_cells * side / whole.extent - 1e-9)) if side > 0 else 1 for side in sides]
    edges = [torch.linspace(-1, 1, count + 1, dtype=torch.float64) for count in counts]
    area = _AREAS[whole.shape](*edges)
    q, p = ((edge[1:] + edge[:-1]) / 4 * side for edge, side in zip(edges, sides, strict=True))
    height, width = (side / count for side, count in zip(sides, counts, strict=True))
    return Cells(p, q, area / area.sum(), height, width)


def needed(whole: Aperture, speeds: Sequence[float]) -> int:
    """How many cells a side resolve what surfaces hide of each other.

    A blur within cells stands for a surface that moves while others stand still, however far; two that move at once
    must not move far within a cell. On a disc one that moves is enough. A surface alone gets as many as two alike.

    Args:
        whole: The aperture.
        speeds: Pixels that each surface moves per view step, at least 0.
    """
    both = sorted(speeds)[-1 if whole.shape == "disc" else -2 :]
    joint = both[0] if both else 0.0
    return 1 + math.ceil(CELLS_PER_ROOT[whole.shape] * math.sqrt(whole.extent * joint) - 1e-9)


def _rectangle(edges_q: Tensor, edges_p: Tensor) -> Tensor:
    """Open area of each cell of a square of side 2 about 0, [J + 1], [I + 1] -> [J, I]."""
    return edges_q.diff()[:, None] * edges_p.diff()


_AREAS: dict[str, Callable[[Tensor, Tensor], Tensor]] = {"square": _rectangle, "disc": cells.of_disc}
