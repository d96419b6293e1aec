"""What the compiled loops of shift-and-sum compute for some planes, apart from the views, as plain numbers."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.refocus import footprint
from lfref.refocus.sampling import Border, Interpolation
from lfref.refocus.shift.shifts import Shifts


class Plan(NamedTuple):
    """The planes to be summed; equal plans are one key of a cache. N planes, R lines of views, M views in each."""

    rows: tuple[tuple[float, ...], ...]
    """Vertical shift of each line in pixels, [N, R]."""
    columns: tuple[tuple[tuple[float, ...], ...], ...]
    """Horizontal shift of each view of a line, [N, R, M]; [N, 1, M] if all lines are alike."""
    widths: tuple[float, ...]
    """Width of the box that blurs each sum, in pixels, [N]; 0: none."""
    aperture: tuple[tuple[float, ...], ...]
    """Weight of each view, of sum 1, by lines, [R, M]."""
    size: tuple[int, int]
    """Height and width of a view in pixels."""
    interpolation: Interpolation
    border: Border

    @property
    def is_separable(self) -> bool:
        """Whether all lines have their views at the same columns."""
        return all(len(columns) == 1 for columns in self.columns)

    @property
    def reach(self) -> int:
        """Samples beyond the edge that may be read."""
        lines = (*self.rows, *(line for plane in self.columns for line in plane))
        return math.ceil(max(abs(shift) for line in lines for shift in line)) + 1

    def shifts(self, n: int) -> Shifts:
        """Those of plane n as tensors."""
        rows, columns, widths = (
            torch.tensor([own[n]], dtype=torch.float64) for own in (self.rows, self.columns, self.widths)
        )
        return Shifts(
            rows, columns, footprint.taps(widths, footprint.radius(self.widths[n])) if self.widths[n] > 0 else None
        )


def plan(
    shifts: Shifts,
    widths: list[float] | None,
    aperture: Tensor,
    size: tuple[int, int],
    interpolation: Interpolation,
    border: Border,
) -> Plan:
    """The plan of shifts and of widths [N] of boxes, for an aperture [R, M] of sum 1."""
    rows, columns, weights = (part.tolist() for part in (shifts.rows, shifts.columns, aperture))
    boxes = widths or [0.0] * len(rows)
    planes = tuple(tuple(map(tuple, plane)) for plane in columns)
    return Plan(tuple(map(tuple, rows)), planes, tuple(boxes), tuple(map(tuple, weights)), size, interpolation, border)
