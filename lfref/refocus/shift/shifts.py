"""By how much views are shifted for some planes, and how many of them have a sample at a pixel then.

Letters: `v u` view row and column, `s` slope in pixels per view step, `N` planes, `R M` lines of views and views in
each (`batches.lines`), `K` taps of a box.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from lfref.functional.devices import on_device
from lfref.refocus import batches, footprint, sampling
from lfref.refocus.sampling import Border, Interpolation

ROUNDING = 2.0**-22
"""Uncertainty of a shift, relative to its size, where slopes are float32: two roundings, and a half of room."""


@dataclass(frozen=True, eq=False)
class Shifts:
    """Shifts of the views for some planes, and the boxes that blur the sums."""

    rows: Tensor
    """Vertical shift of each line in pixels, float64, [N, R]."""
    columns: Tensor
    """Horizontal shift of each view of a line, [N, R, M]; [N, 1, M] if all lines are alike."""
    boxes: Tensor | None = None
    """Taps of the box of each plane (`footprint.taps`), [N, K]; None: the sums stay as they are."""

    def to(self, device: torch.device) -> "Shifts":
        """The same on a device."""
        rows, columns = (on_device(part, device) for part in (self.rows, self.columns))
        return Shifts(rows, columns, self.boxes)

    def sampled(self, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
        """1 where a line has a sample at a row, and a view at a column, else 0: [N, R, H] and [N, R or 1, M, W]."""
        rows, columns = (
            sampling.is_sampled(shifts[..., None], torch.arange(length, device=shifts.device), length).double()
            for shifts, length in zip((self.rows, self.columns), size, strict=True)
        )
        return rows, columns

    def blurred(self, lines: Tensor, border: Border) -> Tensor:
        """Lines [N, ..., L] blurred by the boxes."""
        return lines if self.boxes is None else footprint.boxed_lines(lines, self.boxes, border)

    def coverage(self, aperture: Tensor, size: tuple[int, int], border: Border) -> tuple[Tensor, Tensor]:
        """Share of an aperture [R, M] with a sample at each pixel, and the same blurred by the boxes, [N, H, W]."""
        # A box is a product of a row and a column, and so is the coverage of a view.
        rows, columns = (part.to(aperture) for part in self.sampled(size))
        covered = combined(rows, columns, aperture)
        if self.boxes is None:
            return covered, covered
        return covered, combined(self.blurred(rows, border), self.blurred(columns, border), aperture)


def combined(rows: Tensor, columns: Tensor, aperture: Tensor) -> Tensor:
    """Weighted sums of products of rows [N, R, H] and columns [N, R or 1, M, W] of views, [N, H, W]."""
    if columns.shape[1] == 1:
        return rows.mT @ (aperture @ columns[:, 0])
    return rows.mT @ (aperture[..., None] * columns).sum(2)


def shifts_of(
    planes: Tensor, grid: tuple[int, int], interpolation: Interpolation, positions: Tensor | None = None
) -> Shifts:
    """The shifts for slopes [N], on their device."""
    cameras = batches.lines(grid, positions)
    rows, columns = (interpolation.snap(moved(planes, on_device(offsets, planes.device))) for offsets in cameras)
    return Shifts(rows, columns)


def moved(planes: Tensor, offsets: Tensor) -> Tensor:
    """Shifts [N, ...] by offsets [...]; of float32 slopes, what rounding may have moved off a whole or half pixel is
    taken as such: borders depend on it."""
    shifts = planes.double().reshape(-1, *[1] * offsets.ndim) * offsets
    if planes.dtype == torch.float64:
        return shifts
    halves = (2 * shifts).round()
    return torch.where((2 * shifts - halves).abs() <= ROUNDING * halves.abs(), halves / 2, shifts)
