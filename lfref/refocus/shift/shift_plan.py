"""What shift-and-sum has to compute for some planes, apart from the views: one plan for PyTorch and Numba.

Letters: `v u` view row and column, `s` slope in pixels per view step, `R M` lines of views and views in each
(`batches.lines`).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.errors import chosen
from lfref.refocus import batches, sampling
from lfref.refocus.sampling import BORDERS, INTERPOLATIONS, Border, Interpolation


class Shifts(NamedTuple):
    """Shifts of the views for one plane, and the blur of their sum, in pixels."""

    rows: tuple[float, ...]
    """Vertical shift of each line, [R]."""
    columns: tuple[tuple[float, ...], ...]
    """Horizontal shift of each view of a line, [R, M]; [1, M] if all lines are alike."""
    width: float = 0.0
    """Width of the box that blurs the sum; 0: none."""


class Plan(NamedTuple):
    """The planes to be summed; plain numbers, so that equal plans are one key of a cache."""

    planes: tuple[Shifts, ...]
    """[N]."""
    aperture: tuple[tuple[float, ...], ...]
    """Weight of each view, of sum 1, by lines, [R, M]."""
    size: tuple[int, int]
    """Height and width of a view in pixels."""
    interpolation: Interpolation
    border: Border

    @property
    def is_separable(self) -> bool:
        """Whether all lines have their views at the same columns."""
        return all(len(shifts.columns) == 1 for shifts in self.planes)

    @property
    def reach(self) -> int:
        """Samples beyond the edge that may be read."""
        largest = max(abs(shift) for plane in self.planes for line in (plane.rows, *plane.columns) for shift in line)
        return math.ceil(largest) + 1

    def span(self, shift: float, axis: int) -> tuple[int, int]:
        """First and one-past-last output sample that a view shifted along an axis of [H, W] counts for."""
        length = self.size[axis]
        return sampling.sampled_span(shift, length) if self.border.counts_only_samples else (0, length)

    def coverage(self, shifts: Shifts, chosen_rows: NDArray[np.int64] | None = None) -> Tensor:
        """Share of the aperture with a sample at each pixel of a plane, float64, CPU, [H, W] or chosen rows of it."""
        rows = sampling.sampled(shifts.rows, self.size[0])
        rows = rows if chosen_rows is None else rows[:, chosen_rows]
        columns = torch.stack([sampling.sampled(line, self.size[1]) for line in shifts.columns])
        aperture = torch.tensor(self.aperture, dtype=torch.float64)
        if len(columns) == 1:
            return torch.einsum("vy,vu,ux->yx", rows, aperture, columns[0])
        return rows.T @ torch.einsum("vu,vux->vx", aperture, columns)


def plan(
    planes: Tensor,
    grid: tuple[int, int],
    size: tuple[int, int],
    interpolation: str = "linear",
    border: str = "renormalize",
    weights: Tensor | None = None,
    widths: Sequence[float] | None = None,
    positions: Tensor | None = None,
) -> Plan:
    """The plan of refocusing at slopes that `batches.checked_slopes` let pass; `widths` of boxes in pixels, [N]."""
    method, cameras = chosen("interpolation", interpolation, INTERPOLATIONS), batches.lines(grid, positions)
    offsets = [cameras.rows.tolist(), *cameras.columns.tolist()]
    shifts = []
    for slope, width in zip(planes.tolist(), widths or [0.0] * len(planes), strict=True):
        rows, *columns = (tuple([method.snap(slope * offset) for offset in line]) for line in offsets)
        shifts.append(Shifts(rows, tuple(columns), width))
    aperture = batches.checked_weights(weights, grid).reshape(cameras.shape).tolist()
    rule = chosen("border", border, BORDERS)
    return Plan(tuple(shifts), tuple(map(tuple, aperture)), size, method, rule)
