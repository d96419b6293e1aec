"""What shift-and-sum has to do, whoever does it: PyTorch, or loops compiled for the CPU or a GPU (`by_...`).

Letters: `v u` view row and column, `s` slope in pixels per view step.
"""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.errors import chosen
from lfref.geometry import Slopes
from lfref.refocus import batches, borders, lines
from lfref.refocus.borders import BORDERS, Border
from lfref.refocus.footprint import by_torch as boxes
from lfref.refocus.interpolations import INTERPOLATIONS, Interpolation


class Shifts(NamedTuple):
    """How far one plane shifts the views, and how widely it then blurs their sum, in pixels."""

    rows: tuple[float, ...]
    """Vertical shift of each view row, [V]."""
    columns: tuple[tuple[float, ...], ...]
    """Horizontal shift of each view of a row, [V, U]; [1, U] if that of all rows is the same."""
    width: float = 0.0
    """Of the box that a view's cell covers; 0: a point."""

    def along_row(self, v: int) -> tuple[float, ...]:
        """Horizontal shift of each view of row v, [U]."""
        return self.columns[v if len(self.columns) > 1 else 0]


class Task(NamedTuple):
    """Planes to be summed, apart from the views themselves."""

    planes: tuple[Shifts, ...]
    """[N]."""
    aperture: tuple[tuple[float, ...], ...]
    """Weight of each view, together 1, [V, U]: the rows that it says, whatever those of the grid."""
    size: tuple[int, int]
    """Height and width of a view in pixels."""
    interpolation: Interpolation
    """How a view is read between its samples."""
    border: Border
    """How a view continues beyond its edge."""

    @property
    def blurs(self) -> bool:
        """Whether any plane is seen through cells instead of points."""
        return any(shifts.width > 0 for shifts in self.planes)

    @property
    def is_separable(self) -> bool:
        """Whether all rows of views stand at the same columns."""
        return all(len(shifts.columns) == 1 for shifts in self.planes)

    @property
    def reach(self) -> int:
        """Samples beyond the edge that may be read."""
        taken = (shift for shifts in self.planes for shift in itertools.chain(shifts.rows, *shifts.columns))
        return math.ceil(max(map(abs, taken))) + 1

    def span(self, shift: float, axis: int) -> tuple[int, int]:
        """First and one-past-last output sample that a view shifted along an axis of [H, W] counts for."""
        length = self.size[axis]
        return borders.sampled_span(shift, length) if self.border.counts_only_samples else (0, length)

    def beyond(self, axis: int) -> Tensor:
        """Sample that stands at each place from -reach to length + reach along an axis; -1: black, int64, CPU."""
        numbered = torch.arange(1, self.size[axis] + 1, dtype=torch.float64)
        return self.border.extend(numbered[None], self.reach, -1)[0].long() - 1

    def coverage(self, shifts: Shifts) -> Tensor:
        """Share of the aperture that has a sample at each pixel of a plane, float64, CPU, [H, W]."""
        rows, columns = self.sampled(shifts)
        aperture = torch.tensor(self.aperture, dtype=torch.float64)
        if len(columns) == 1:
            return torch.einsum("vy,vu,ux->yx", rows, aperture, columns[0])
        return rows.T @ torch.einsum("vu,vux->vx", aperture, columns)

    @property
    def coverages(self) -> Tensor:
        """The same of all planes, [N, H, W]."""
        return torch.stack([self.coverage(shifts) for shifts in self.planes])

    def sampled(self, shifts: Shifts) -> tuple[Tensor, Tensor]:
        """Where view rows, and views of each row, have a sample: 1 or 0, float64, CPU, [V, H] and [V or 1, U, W]."""
        columns = [borders.sampled(list(row), self.size[1]) for row in shifts.columns]
        return borders.sampled(list(shifts.rows), self.size[0]), torch.stack(columns)

    def factors(self, shifts: Shifts) -> Tensor:
        """What a plane's sum, blurred, is multiplied by: 1 over the coverage, as blurred, if only samples count."""
        if not self.border.counts_only_samples:
            return torch.ones(self.size, dtype=torch.float64)
        covered = self.coverage(shifts)
        return boxes.inverse(covered, boxes.boxed(covered, shifts.width, self.border))


def plan(
    slopes: Slopes,
    grid: tuple[int, int],
    size: tuple[int, int],
    interpolation: str = "linear",
    border: str = "renormalize",
    weights: Tensor | None = None,
    widths: Sequence[float] | None = None,
    positions: Tensor | None = None,
) -> Task:
    """The task of refocusing at some slopes.

    Args:
        slopes: Focus in pixels per view step, [N].
        grid: Number of view rows and columns (V, U).
        size: Height and width (H, W) of a view in pixels.
        interpolation: A key of `INTERPOLATIONS`.
        border: A key of `BORDERS`.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.
        widths: Of the box that each plane is blurred by, in pixels, >= 0, [N]; None blurs none.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Raises:
        InputError: Slopes, weights, positions or names that cannot be used.
    """
    method, cameras = chosen("interpolation", interpolation, INTERPOLATIONS), lines.lines(grid, positions)
    planes = lines.checked_slopes(slopes, grid, size, positions).tolist()
    offsets = [cameras.rows.tolist(), *cameras.columns.tolist()]

    def shifts(slope: float, width: float) -> Shifts:
        rows, *columns = (tuple(method.snap(slope * offset) for offset in line) for line in offsets)
        return Shifts(rows, tuple(columns), width)

    return Task(
        tuple(map(shifts, planes, widths or [0.0] * len(planes))),
        tuple(map(tuple, batches.checked_weights(weights, grid).reshape(cameras.shape).tolist())),
        size,
        method,
        chosen("border", border, BORDERS),
    )
