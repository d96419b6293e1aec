"""Positions of the views of a light field, from displacements of patches explained by views and by disparities; and
the two defects of positions: views that are misaligned, and rows that are spaced otherwise than columns.

Patch k of view i shows `f_k(x - D_k p_i - s_i)`: texture f, disparity D of rows and of columns, position p of the view
from the angular centre, shift s of the view. Two parts of the shifts are unknown, and left at 0: their mean (the place
of the scene), and shifts in proportion to p along rows and along columns (a disparity of the whole scene).
Alignment: each view is shifted back as a whole, L(x) -> L(x - s), by a fraction of a pixel.
Spacing: disparities along rows are `ratio` times those along columns. Views that are misaligned in proportion to their
row or column add a constant to all disparities along it. The scale of both is unknown, so columns keep their positions.
Letters: `k` patch, `i` view, `c` channel, `V U` view rows and columns.
"""

import dataclasses
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from lfref import geometry
from lfref.captures import Defect, displacements
from lfref.captures.displacements import OUTLYING, SIDE, TINY, Fitted, Observed, Patches
from lfref.functional import interpolation
from lfref.lightfield import LightField
from lfref.refocus import batches

SETTLED = 0.08  # pixels, by trial: patches that moved less are not read again
FEWEST_PATCHES = 12  # three for each quarter
LOOSE = 0.3  # pixels, by trial: standard deviation of shifts before any measurement
UNEXPLAINED = 0.01  # share of a patch's contrast, by trial: least error, from interpolation and gloss
STRIPES = 0.01  # share of the texture in the strongest direction, by trial: less texture across may be a trace of it
SYSTEMATIC = 0.02  # pixels, by trial: least error of a patch, however fine its texture
SURE = 5.0  # standard errors from which a defect is certain, by trial
LEAST_SHIFT = 0.02  # pixels: smaller shifts cost less than .2 dB of the best picture
LINEAR = 3.0  # times the rms of the other shifts, by trial: stripes look like larger linear parts
LEAST_EFFECT = 0.04  # least displacement of patches of large disparity in the outermost view, in pixels, by trial
CLEAR = 0.6  # least share of the scatter of patches, by trial: bent and glossy surfaces scatter all patches
LIKELY = 0.2  # by trial: standard deviation of the ratio before any measurement, since cameras are built evenly
UNKNOWN = "unknown: too little texture, or too few views"
LEAST_ERROR = 0.002  # pixels per view step, by trial: the least error of a patch's disparities


class Explanation(NamedTuple):
    """Shifts of views and disparities of patches that explain displacements best."""

    shifts: Tensor  # shifts of the views (down, right) in pixels, float64, [I, 2]
    disparities: Tensor  # disparities of the patches along rows and along columns, in pixels per view step, [K, 2]
    precision: Tensor  # inverse variance of the disparities, [K, 2]
    trust: Tensor  # weight of each displacement, [0, 1], [K, I]


class Registration(NamedTuple):
    """Patches, their observed displacements, and the explanation of these."""

    field: LightField
    patches: Patches
    positions: Tensor  # positions of all views from the angular centre, [I, 2]
    expected: Tensor  # displacements at which patches were read, in pixels, [K, I, 2]
    observed: Observed  # displacements of each channel from the expected ones
    information: Tensor  # information of all channels, in inverse square pixels, [K, 2, 2]
    moved: Tensor  # displacements (down, right) in pixels, [K, I, 2]
    explanation: Explanation

    def explain(self, unknown: Tensor, chosen: Tensor | slice = slice(None)) -> Explanation:
        """The function `explain` for the patches `chosen`, with other `unknown` shifts."""
        shown = self.observed.shown[chosen]
        return explain(self.information[chosen], self.moved[chosen], shown, self.positions, unknown)

    def quarters(self) -> list[Tensor]:
        """Patches of each quarter of the picture, bool [K] each: up to four independent estimates."""
        low, right = (self.patches.centres > self.patches.centres.median(0).values).unbind(-1)
        quarters = [low & right, low & ~right, ~low & right, ~low & ~right]
        return [quarter for quarter in quarters if bool(quarter.any())]


def register(field: LightField, disparity: Tensor, reference: tuple[int, int]) -> Registration | None:
    """Read patches in all views, and explain their displacements; None: too few. The disparity is of `reference`."""
    views = field.views.detach().cpu().flatten(0, 1)
    if len(views) < 3 or min(field.size) < 4 * SIDE:
        return None
    positions = positions_of(field)
    grey = field.views[reference].cpu().float().mean(0)
    patches = displacements.choose_patches(grey, disparity.cpu(), positions, views.shape[1])
    if len(patches.rows) < FEWEST_PATCHES:
        return None
    shown = _shown(field, patches, positions)
    expected = patches.disparity[:, None, None] * positions
    for _ in range(4):  # number of readings at the estimated places, by trial
        read_at = expected
        observed = displacements.observe(displacements.read_patches(views, patches, read_at), shown)
        information, moved = combined(observed, read_at)
        explanation = explain(information, moved, observed.shown, positions, linear_shifts(positions))
        expected = explanation.disparities[:, None] * positions + explanation.shifts
        if float((expected - read_at).abs().amax((1, 2)).median()) < SETTLED:
            break
    return Registration(field, patches, positions, read_at, observed, information, moved, explanation)


def positions_of(field: LightField) -> Tensor:
    """Positions of the views from the angular centre, (v, u) in view steps, float64, [V U, 2]."""
    positions = batches.even(field.grid) if field.positions is None else field.positions
    return positions.double().cpu().flatten(0, 1)


def _shown(field: LightField, patches: Patches, positions: Tensor) -> Tensor:
    """1 where the view has weight all over the patch, else 0, [K, I]."""
    if field.weight is None:
        return torch.ones(len(patches.rows), len(positions), dtype=torch.float64)
    read_at = patches.disparity[:, None, None] * positions
    weight = displacements.read_patches(field.weight.cpu().flatten(0, 1), patches, read_at)
    return (weight.amin((2, 3, 4)) >= 0.5).double()


def explain(information: Tensor, moved: Tensor, shown: Tensor, positions: Tensor, unknown: Tensor) -> Explanation:
    """Find shifts and disparities by least squares that give outliers less weight; `unknown` shifts [2I, M] stay 0."""
    n_views, trust = len(positions), shown
    # Onto the unknown shifts of the views that are there: missing ones would absorb them.
    unknown = unknown * shown.any(0).repeat_interleave(2)[:, None]
    projection = unknown @ torch.linalg.pinv(unknown, rtol=1e-6)
    for _ in range(4):  # number of weightings of outliers, by trial
        weights = trust[..., None, None] * information[:, None]
        # Normal equations of (shifts, disparities). Disparities are eliminated first: they belong to one patch each.
        right = (weights @ moved[..., None])[..., 0]
        cross = weights * positions[:, None]  # mixed terms of shifts and disparities
        inner = displacements.ridged(torch.einsum("ia,kiab->kab", positions, cross))
        own = (right * positions).sum(1)
        columns = cross.flatten(1, 2)
        onto = torch.linalg.solve(inner, columns.mT)
        curvature = torch.block_diag(*weights.sum(0)) - torch.einsum("kxb,kby->xy", columns, onto)
        curvature = curvature + torch.eye(2 * n_views, dtype=weights.dtype) / LOOSE**2
        # Unknown shifts get a penalty as large as all measurements.
        curvature = curvature + curvature.diagonal().mean() * projection
        slope = right.sum(0).flatten() - torch.einsum("kby,kb->y", onto, own)
        shifts = torch.linalg.solve(curvature, slope).unflatten(0, (n_views, 2))
        disparities = torch.linalg.solve(inner, own - torch.einsum("kiab,ia->kb", cross, shifts))
        rest = moved - shifts - disparities[:, None] * positions
        outlying = ((rest @ information) * rest).sum(-1)
        typical = (outlying[shown > 0] if bool(shown.any()) else outlying).median().clamp(min=TINY)
        trust = shown / (1 + outlying / (OUTLYING**2 * typical))
    return Explanation(shifts, disparities, inner.diagonal(dim1=-2, dim2=-1) / typical, trust)


PROPORTIONAL = slice(4)  # those of `linear_shifts` that are equal for all views, or in proportion to the positions


def linear_shifts(positions: Tensor) -> Tensor:
    """Six patterns of shifts, of length 1: two equal for all views, four linear in the positions, [2I, 6]."""
    eye = torch.eye(2, dtype=positions.dtype)
    around = (positions - positions.mean(0))[:, :, None]
    modes = torch.cat([eye.expand(len(positions), 2, 2), around * eye, around.flip(1) * eye], -1).flatten(0, 1)
    return modes / modes.norm(dim=0).clamp(min=TINY)


def combined(observed: Observed, read_at: Tensor) -> tuple[Tensor, Tensor]:
    """Information [K, 2, 2] and displacements [K, I, 2] of all channels, weighted by their noise."""
    noise = noise_of(observed)
    together = (observed.information / noise[..., None, None]).sum(1)
    moments = observed.moments + torch.einsum("kcab,kib->kica", observed.information, read_at)
    moments = (moments / noise[:, None, :, None]).sum(2)
    return limited(together), moments @ displacements.ridged(together).inverse()


def noise_of(observed: Observed) -> Tensor:
    """Variance of samples that displacements do not explain, [K, C]."""
    noise = observed.rest.median(1).values / SIDE**2
    texture = observed.templates.var((-2, -1)).double()
    return noise + noise.median(0).values.clamp(min=TINY) + UNEXPLAINED**2 * texture


def limited(information: Tensor) -> Tensor:
    """Information [..., 2, 2] limited to the real accuracy: bent surfaces, highlights and interpolation err too."""
    values, vectors = torch.linalg.eigh(information)
    sure = (values - STRIPES * values[..., 1:]).clamp(min=0)
    sure = sure / (1 + SYSTEMATIC**2 * sure)
    return (vectors * sure[..., None, :]) @ vectors.mT


def resampled(field: LightField, rows: Tensor, columns: Tensor) -> LightField:
    """A light field whose views and weights are read elsewhere; arguments are those of `interpolation.resample`."""
    weight = field.weight
    if weight is not None:
        # Weights have one channel: it is read at the mean place of the colours.
        means = (places.expand(*field.views.shape[:3], -1).mean(2, keepdim=True) for places in (rows, columns))
        weight = interpolation.resample(weight, *means).clamp(0, 1)
    return dataclasses.replace(field, views=interpolation.resample(field.views, rows, columns), weight=weight)


@dataclass(frozen=True, eq=False)
class AlignmentDefect(Defect):
    """Shifts of views."""

    name = "alignment"

    shifts: Tensor  # shifts down and right, in pixels, float64, [V, U, 2]
    error: float  # standard error of a shift along an axis in pixels, from the quarters of the picture

    def summary(self) -> str:
        """Size of the shifts, and what remains unknown."""
        rms, largest = float(self.shifts.square().mean().sqrt()), float(self.shifts.norm(dim=-1).max())
        return (
            f"views lie {rms:.3f} px (rms), at most {largest:.3f} px beside their places, to {self.error:.3f} px; "
            "a shift of all views, or in proportion to the view's place, is unknown"
        )

    def corrected(self, field: LightField) -> LightField:
        """Views shifted back."""
        rows, columns = (geometry.angular_offsets(length) for length in field.size)
        down, right = self.shifts[:, :, None, None].unbind(-1)
        return resampled(field, rows + down, columns + right)


def find_alignment(registered: Registration | None) -> AlignmentDefect | str:
    """Estimate the shift of every view; without a registration the shifts are unknown."""
    if registered is None:
        return UNKNOWN
    shifts = registered.explanation.shifts
    rms = float(shifts.square().mean().sqrt())
    linear = linear_shifts(registered.positions)
    if rms > LEAST_SHIFT:
        # Shifts linear in the other coordinate of the position count only if they are about as large as the rest.
        larger = registered.explain(linear[:, PROPORTIONAL]).shifts
        if float((linear.mT @ larger.flatten()).abs().max()) < LINEAR * rms:
            shifts = larger
    quarters = torch.stack([registered.explain(linear, quarter).shifts for quarter in registered.quarters()])
    error = float(quarters.var(0).mean().sqrt() / len(quarters) ** 0.5)
    rms = float(shifts.square().mean().sqrt())
    if rms <= max(LEAST_SHIFT, SURE * error):
        return f"views lie within {rms:.3f} px (rms) of their places, to {error:.3f} px"
    return AlignmentDefect(shifts.unflatten(0, registered.field.grid), error)


@dataclass(frozen=True, eq=False)
class SpacingDefect(Defect):
    """Distance between view rows, in steps of view columns."""

    name = "spacing"

    ratio: float  # factor that corrects the rows' positions
    error: float  # standard error of the ratio
    spacing: float = 1.0  # distance between rows over that between columns by the positions before the correction

    def summary(self) -> str:
        """The ratio, and the reader's option that sets the same."""
        return f"{self.distances()} (reader.spacing=[{self.ratio * self.spacing:.4f},1])"

    def distances(self) -> str:
        """The ratio and its error."""
        error = self.error * self.spacing
        return f"rows are {self.ratio * self.spacing:.4f} times as far apart as columns, to {error:.4f}"

    def corrected(self, field: LightField) -> LightField:
        """The same views at corrected positions."""
        positions = positions_of(field).unflatten(0, field.grid) * torch.tensor([self.ratio, 1.0], dtype=torch.float64)
        return dataclasses.replace(field, positions=positions)


def find_spacing(registered: Registration | None) -> SpacingDefect | str:
    """Compare disparities along rows and along columns; unknown without a registration, or in a single row."""
    if registered is None or min(registered.field.grid) == 1:
        return UNKNOWN
    fit, ratio = fit_ratio(registered, torch.ones(len(registered.observed.shown), dtype=torch.bool))
    quarters = torch.tensor([fit_ratio(registered, quarter)[1] for quarter in registered.quarters()])
    error = max(float(fit.errors[1]), float(quarters.std()) / len(quarters) ** 0.5)
    disparities, excess = registered.explanation.disparities[:, 1].abs(), abs(float(fit.values[1]))
    shift = excess * float(disparities.quantile(0.9)) * float(registered.positions[:, 0].abs().max())
    shows = shift > LEAST_EFFECT and excess * float(disparities.median()) > CLEAR * fit.scatter
    positions = registered.positions.unflatten(0, registered.field.grid)
    rows, columns = (float(positions.diff(dim=axis)[..., axis].mean()) for axis in (0, 1))
    defect = SpacingDefect(ratio, error, rows / columns)
    return defect if abs(ratio - 1) > SURE * error and shows else defect.distances()


def fit_ratio(registered: Registration, chosen: Tensor) -> tuple[Fitted, float]:
    """Fit a + b d to the difference of both disparities of the chosen patches; returns the fit and its ratio."""
    explanation = registered.explanation
    disparities, precision = explanation.disparities[chosen], explanation.precision[chosen].clamp(min=TINY)
    share = precision / precision.sum(-1, keepdim=True)
    variance = (1 / precision).sum(-1) + LEAST_ERROR**2
    # The error of the difference is independent of that of this mean d; otherwise the ratio would tend to 0.
    mean = (share * disparities).sum(-1)
    model = torch.stack([torch.ones_like(mean), mean], -1)[:, None]
    # Shifts of single views differ along rows and columns by chance, which gives a constant difference of this size.
    rms = explanation.shifts.square().mean().sqrt()
    chance = float(LEAST_ERROR + rms * (1 / registered.positions.square().sum(0)).sum().sqrt())
    prior = torch.tensor([1 / chance**2, 1 / LIKELY**2], dtype=mean.dtype)
    difference = disparities[:, 0] - disparities[:, 1]
    fit = displacements.fit_linear(model, difference[:, None], 1 / variance[:, None, None], prior)
    excess = float(fit.values[1])
    return fit, 1 + excess / (1 - float(share[:, 0].mean()) * excess)
