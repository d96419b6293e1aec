"""Alignment: views that lie a fraction of a pixel beside their places.

Each view is shifted as a whole, L(x) -> L(x - s). What cannot be told from the scene is left: the mean of all shifts
(where the scene is), and parts in proportion to the view's place along rows and along columns (its disparities).
Letters: `V U` view rows and columns, `s` shift.
"""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from lfref.captures import registration, resampling
from lfref.captures.defect import Correction, Evidence
from lfref.captures.registration import Registration, registered
from lfref.lightfield import LightField

SHOWN = 0.02  # pixels: shifts that cost less than .2 dB of the best picture
SURE = 5.0  # standard errors
USUAL = 3.0  # of what shifts are otherwise, at most: parts linear in the place that stripes feign are larger


@dataclass(frozen=True, eq=False)
class Alignment:
    """Shifts of views."""

    name: ClassVar[str] = "alignment"

    shifts: Tensor
    """Down and right, in pixels, float64, [V, U, 2]."""
    error: float
    """Standard error of a shift along an axis, from how quarters of the picture disagree, in pixels; infinite where
    nothing could be seen."""

    @property
    def size(self) -> float:
        """Root mean square of the shifts along an axis, in pixels."""
        return float(self.shifts.square().mean().sqrt())

    def inert(self) -> str | None:
        """Nothing moves where shifts are too small to matter, or no larger than their errors."""
        if self.error == float("inf"):
            return "too little texture, or too few views, to tell"
        if self.size > max(SHOWN, SURE * self.error):
            return None
        return f"views lie within {self.size:.3f} px (rms) of their places, to {self.error:.3f} px"

    def told(self) -> str:
        """How far views are off, and what cannot be known."""
        return (
            f"views lie {self.size:.3f} px (rms), at most {float(self.shifts.norm(dim=-1).max()):.3f} px beside their "
            f"places, to {self.error:.3f} px; a shift of all, or in proportion to the view's place, cannot be known"
        )

    def corrected(self, field: LightField) -> LightField:
        """Views where they belong."""
        rows, columns = resampling.centred(field.size)
        down, right = self.shifts[:, :, None, None].unbind(-1)
        return resampling.moved(field, rows + down, columns + right)


def find(evidence: Evidence) -> Alignment:
    """Find the shift of every view.

    Args:
        evidence: Of the light field.
    """
    found = registered(evidence)
    grid = evidence.field.grid
    if found is None:
        return Alignment(torch.zeros(*grid, 2, dtype=torch.float64), float("inf"))
    shifts = found.solved.shifts
    if float(shifts.square().mean().sqrt()) > SHOWN:
        shifts = _with_linear(found)
    return Alignment(shifts.unflatten(0, grid), _error(found))


def _with_linear(found: Registration) -> Tensor:
    """Shifts with their parts linear in the place, across rows and columns, where these are like the others in size."""
    without = found.solved.shifts
    free = found.again(registration.proportional(found.places)).shifts
    modes = registration.linear(found.places)
    linear = modes.mT @ free.flatten()
    usual = float(without.square().mean().sqrt())
    return free if float(linear.abs().max()) < USUAL * usual else without


def _error(found: Registration) -> float:
    """Standard error of shifts, from how far quarters of the picture disagree."""
    modes = registration.linear(found.places)
    each = torch.stack([found.again(modes, quarter).shifts for quarter in found.quarters()])
    return float(each.var(0).mean().sqrt() / len(each) ** 0.5)


ALIGNMENT = Correction(Alignment, "a few dozen textured patches in three views or more", find)
