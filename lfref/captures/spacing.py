"""Spacing: rows of views that lie closer or farther apart than columns do.

Disparities along rows are then `ratio` times those along columns, plus what shifts in proportion to the view's row or
column add by chance. How far apart views are on the whole cannot be known, so columns keep their places.
Letters: `V U` view rows and columns.
"""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from lfref.captures import displacements
from lfref.captures.defect import Correction, Evidence
from lfref.captures.displacements import FAINT, Fitted
from lfref.captures.registration import Registration, places_of, registered
from lfref.lightfield import LightField

SHOWN = 0.04  # pixels between where views lie and where an even grid has them, for the outermost view and patch
SURE = 5.0  # standard errors
CLEAR = 0.6  # of the scatter of patches
LIKELY = 0.2  # standard deviation of the ratio before anything is seen
LEAST_ERROR = 0.002  # pixels per view step: no patch knows its disparities better


@dataclass(frozen=True, eq=False)
class Spacing:
    """How far rows of views are apart, in the steps of its columns."""

    name: ClassVar[str] = "spacing"

    ratio: float
    """Over what the field's positions say; 1 where they are taken to be right."""
    found: float
    """The same as it was estimated, whether it is sure or not; not a number where nothing could be seen."""
    error: float
    """Its standard error."""

    def inert(self) -> str | None:
        """Nothing changes where rows and columns seem to be alike."""
        if self.ratio != 1:
            return None
        if self.found != self.found:
            return "too little depth or texture, or too few rows and columns of views, to tell"
        return f"rows are {self.found:.4f} times as far apart as columns, to {self.error:.4f}"

    def told(self) -> str:
        """The ratio, and the option that says the same at reading."""
        return (
            f"rows are {self.ratio:.4f} times as far apart as columns, to {self.error:.4f} "
            f"(reader.spacing=[{self.ratio:.4f},1])"
        )

    def corrected(self, field: LightField) -> LightField:
        """The same views, rows at their distance."""
        positions = places_of(field).unflatten(0, field.grid) * torch.tensor([self.ratio, 1.0], dtype=torch.float64)
        return dataclasses.replace(field, positions=positions)


def find(evidence: Evidence) -> Spacing:
    """Compare disparities along rows and along columns.

    Args:
        evidence: Of the light field.
    """
    found = registered(evidence) if min(evidence.field.grid) > 1 else None
    if found is None:
        return Spacing(1.0, float("nan"), float("inf"))
    fit, ratio = _fit(found, torch.ones(len(found.seen.shown), dtype=torch.bool))
    each = torch.tensor([_fit(found, quarter)[1] for quarter in found.quarters()])
    error = max(float(fit.errors[1]), float(each.std()) / len(each) ** 0.5)
    return Spacing(ratio if _is_sure(found, fit, error) else 1.0, ratio, error)


def _fit(found: Registration, chosen: Tensor) -> tuple[Fitted, float]:
    """Difference at disparity 0 and difference for each disparity, by some patches; the ratio that this comes to."""
    disparities, precision = found.solved.disparities[chosen], found.solved.precision[chosen].clamp(min=FAINT)
    share = precision / precision.sum(-1, keepdim=True)
    variance = (1 / precision).sum(-1) + LEAST_ERROR**2
    # What a patch errs in its difference, it does not err in this mean: else the ratio would be drawn to 0.
    mean = (share * disparities).sum(-1)
    model = torch.stack([torch.ones_like(mean), mean], -1)[:, None]
    prior = torch.tensor([1 / _chance(found) ** 2, 1 / LIKELY**2], dtype=mean.dtype)
    difference = disparities[:, 0] - disparities[:, 1]
    fit = displacements.fitted(model, difference[:, None], 1 / variance[:, None, None], prior)
    excess = float(fit.values[1])
    return fit, 1 + excess / (1 - float(share[:, 0].mean()) * excess)


def _chance(found: Registration) -> float:
    """By how much shifts of single views differ along rows and columns in proportion to the place, as a rule."""
    size = found.solved.shifts.square().mean().sqrt()
    return float(LEAST_ERROR + size * (1 / found.places.square().sum(0)).sum().sqrt())


def _is_sure(found: Registration, fit: Fitted, error: float) -> bool:
    excess, disparities = abs(float(fit.values[1])), found.solved.disparities[:, 1]
    farthest = float(disparities.abs().quantile(0.9) * found.places[:, 0].abs().max())
    is_sure = excess > SURE * error
    return is_sure and excess * farthest > SHOWN and excess * float(disparities.abs().median()) > CLEAR * fit.scatter


SPACING = Correction(Spacing, "textures at several disparities, in two rows and columns of views or more", find)
