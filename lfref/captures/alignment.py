"""Misaligned views: each view is shifted as a whole, L(x) -> L(x - s), by a fraction of a pixel.

The scene does not determine the mean of all shifts (where the scene is), nor parts in proportion to the view's row or
column (the scene's disparities): these are left at 0. A file of its own, as each defect has.
Letters: `V U` view rows and columns, `s` shift.
"""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from lfref.captures import registration, resampling
from lfref.captures.registration import Registration
from lfref.lightfield import LightField

SHOWN = 0.02  # pixels: smaller shifts cost less than .2 dB of the best picture
SURE = 5.0  # standard errors, by trial
LINEAR = 3.0  # times the rms of the other shifts, by trial: stripes look like larger linear parts


@dataclass(frozen=True, eq=False)
class AlignmentDefect:
    """Shifts of views."""

    name: ClassVar[str] = "alignment"
    needs_light: ClassVar[bool] = False

    shifts: Tensor
    """Down and right, in pixels, float64, [V, U, 2]."""
    error: float
    """Standard error of a shift along an axis in pixels, from the quarters of the picture; infinite: unknown."""

    def reason_to_skip(self) -> str | None:
        """Why nothing is corrected: shifts are unknown, too small to matter, or not much larger than their errors."""
        if self.error == float("inf"):
            return "unknown: too little texture, or too few views"
        rms = float(self.shifts.square().mean().sqrt())
        if rms > max(SHOWN, SURE * self.error):
            return None
        return f"views lie within {rms:.3f} px (rms) of their places, to {self.error:.3f} px"

    def summary(self) -> str:
        """Size of the shifts, and what remains unknown."""
        rms, largest = float(self.shifts.square().mean().sqrt()), float(self.shifts.norm(dim=-1).max())
        return (
            f"views lie {rms:.3f} px (rms), at most {largest:.3f} px beside their places, to {self.error:.3f} px; "
            "a shift of all views, or in proportion to the view's place, is unknown"
        )

    def corrected(self, field: LightField) -> LightField:
        """Views shifted back."""
        rows, columns = resampling.centred(field.size)
        down, right = self.shifts[:, :, None, None].unbind(-1)
        return resampling.resample_field(field, rows + down, columns + right)


def find(grid: tuple[int, int], registered: Registration | None) -> AlignmentDefect:
    """Estimate the shift of every view; without a registration the shifts are unknown."""
    if registered is None:
        return AlignmentDefect(torch.zeros(*grid, 2, dtype=torch.float64), float("inf"))
    shifts = registered.explanation.shifts
    rms = float(shifts.square().mean().sqrt())
    linear = registration.linear_shifts(registered.positions)
    if rms > SHOWN:
        # Parts linear in the other coordinate of the place count only if they are about as large as the rest.
        larger = registered.explain(registration.proportional_shifts(registered.positions)).shifts
        if float((linear.mT @ larger.flatten()).abs().max()) < LINEAR * rms:
            shifts = larger
    quarters = torch.stack([registered.explain(linear, quarter).shifts for quarter in registered.quarters()])
    error = float(quarters.var(0).mean().sqrt() / len(quarters) ** 0.5)
    return AlignmentDefect(shifts.unflatten(0, grid), error)
