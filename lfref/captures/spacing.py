"""Spacing: rows of views that lie closer or farther apart than columns do.

Disparities along rows are `ratio` times those along columns. Views that are misaligned in proportion to their row or
column add a constant to each. The scale of both is unknown, so columns keep their positions.
A file of its own, as each defect has.
"""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from lfref.captures import displacements
from lfref.captures.displacements import TINY, Fitted
from lfref.captures.registration import Registration, positions_of
from lfref.lightfield import LightField

SHOWN = 0.04  # pixels, by trial: error of the outermost view's position, seen at the farthest patches
SURE = 5.0  # standard errors, by trial
CLEAR = 0.6  # of the scatter of patches, by trial: bent and glossy surfaces scatter in all patches
LIKELY = 0.2  # by trial: standard deviation of the ratio before any measurement, since cameras are built evenly
LEAST_ERROR = 0.002  # pixels per view step, by trial: the least error of a patch's disparities


@dataclass(frozen=True, eq=False)
class SpacingDefect:
    """Distance of view rows in steps of view columns."""

    name: ClassVar[str] = "spacing"
    needs_light: ClassVar[bool] = False

    ratio: float
    """Correction of the rows' positions; 1: none."""
    estimate: float
    """The ratio as it was estimated, whether it is certain or not; NaN: unknown."""
    error: float
    """Its standard error."""

    def reason_to_skip(self) -> str | None:
        """Why nothing is corrected: rows and columns seem to be equally far apart, or their distances are unknown."""
        if self.ratio != 1:
            return None
        if self.estimate != self.estimate:
            return "unknown: too little depth or texture, or too few rows and columns of views"
        return f"rows are {self.estimate:.4f} times as far apart as columns, to {self.error:.4f}"

    def summary(self) -> str:
        """The ratio, and the reader's option that sets the same."""
        return (
            f"rows are {self.ratio:.4f} times as far apart as columns, to {self.error:.4f} "
            f"(reader.spacing=[{self.ratio:.4f},1])"
        )

    def corrected(self, field: LightField) -> LightField:
        """The same views at corrected positions."""
        positions = positions_of(field).unflatten(0, field.grid) * torch.tensor([self.ratio, 1.0], dtype=torch.float64)
        return dataclasses.replace(field, positions=positions)


def find(registered: Registration | None) -> SpacingDefect:
    """Compare disparities along rows and along columns; unknown without a registration, or in a single row."""
    if registered is None or min(registered.field.grid) == 1:
        return SpacingDefect(1.0, float("nan"), float("inf"))
    fit, ratio = fit_ratio(registered, torch.ones(len(registered.observed.shown), dtype=torch.bool))
    quarters = torch.tensor([fit_ratio(registered, quarter)[1] for quarter in registered.quarters()])
    error = max(float(fit.errors[1]), float(quarters.std()) / len(quarters) ** 0.5)
    disparities = registered.explanation.disparities[:, 1].abs()
    outermost = float(registered.positions[:, 0].abs().max())
    is_sure = is_certain(abs(float(fit.values[1])), error, disparities, outermost, fit.scatter)
    return SpacingDefect(ratio if is_sure else 1.0, ratio, error)


def is_certain(excess: float, error: float, disparities: Tensor, outermost: float, scatter: float) -> bool:
    """Whether an excess of disparities along rows is certain, shows in the outermost view, and exceeds the scatter.

    `disparities` are absolute values of patches, [K]; `scatter` is what the excess does not explain of them.
    """
    shift = excess * float(disparities.quantile(0.9)) * outermost
    return excess > SURE * error and shift > SHOWN and excess * float(disparities.median()) > CLEAR * scatter


def fit_ratio(registered: Registration, chosen: Tensor) -> tuple[Fitted, float]:
    """Fit the difference of both disparities as a + b d to the chosen patches; the ratio that follows."""
    explanation = registered.explanation
    disparities, precision = explanation.disparities[chosen], explanation.precision[chosen].clamp(min=TINY)
    share = precision / precision.sum(-1, keepdim=True)
    variance = (1 / precision).sum(-1) + LEAST_ERROR**2
    # The error of the difference is independent of that of this mean d; otherwise the ratio would tend to 0.
    mean = (share * disparities).sum(-1)
    model = torch.stack([torch.ones_like(mean), mean], -1)[:, None]
    # Shifts of single views differ along rows and columns by chance: a constant difference of about this size.
    rms = explanation.shifts.square().mean().sqrt()
    chance = float(LEAST_ERROR + rms * (1 / registered.positions.square().sum(0)).sum().sqrt())
    prior = torch.tensor([1 / chance**2, 1 / LIKELY**2], dtype=mean.dtype)
    difference = disparities[:, 0] - disparities[:, 1]
    fit = displacements.fit_linear(model, difference[:, None], 1 / variance[:, None, None], prior)
    excess = float(fit.values[1])
    return fit, 1 + excess / (1 - float(share[:, 0].mean()) * excess)
