"""Chromatic aberration: colours that differ in size (lateral) or in focus (axial) from the middle one.

Channel c reads at `m_c y + t_c + d_c p` what the middle channel reads at y: see `dispersion`. What is common to all
colours cannot be seen, and the middle colour stays as it is.
Letters: `C` channels, `p` place of a view, `y` pixel from the picture's centre, `m t d` as there.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from lfref.captures import displacements, registration, resampling
from lfref.captures.defect import Correction, Evidence
from lfref.captures.displacements import FAINT, Fitted, Observed
from lfref.captures.registration import Registration, places_of, registered
from lfref.lightfield import LightField

# PART dispersion
# How the colours of a light field differ in size and in focus.
#
# Channel c shows at `m_c y + t_c + d_c p` what the middle channel shows at y: m magnification about the picture's
# centre,
# t an offset, d an added disparity. Disparities of a channel come from its own patches in all views; sizes and offsets
# from a comparison of each channel's mean over the views with that of the middle one.
# Letters: `k` patch, `i` view, `c` channel, `p` place of a view, `y x` pixel row and column from the centre.

ROUNDS = 2  # of reading channels again where they now seem to lie
LEAST_ERROR = 0.003  # pixels per view step: no patch knows its disparity better
FAINTEST = 0.1  # contrast over that of the middle channel
UNEXPLAINED = 0.02  # of a patch's contrast, at the least


class Dispersion(NamedTuple):
    """How a channel differs from the middle one."""

    lateral: Fitted
    """Offset down, offset right in pixels, magnification less 1."""
    axial: Fitted
    """Added disparity in pixels per view step."""


def middle_of(n_channels: int) -> int:
    """The channel that the others are compared with: green of three."""
    return n_channels // 2


def dispersions(found: Registration, seen: Observed) -> list[Dispersion]:
    """Compare all channels with the middle one.

    Args:
        found: Of all channels together.
        seen: Patches, each channel read where it is taken to lie, displacements relative to that.
    """
    n_channels = seen.templates.shape[1]
    disparities, precision = _disparities(found, seen)
    return [
        Dispersion(_lateral(found, seen.templates, c), _axial(disparities, precision, c)) for c in range(n_channels)
    ]


def read_again(found: Registration, offsets: Tensor, sizes: Tensor, disparities: Tensor) -> Observed:
    """Patches with each channel read where it lies.

    Args:
        found: Of all channels together.
        offsets: In pixels, [C, 2].
        sizes: Magnifications less 1, [C].
        disparities: Added ones, in pixels per view step, [C].
    """
    views = found.field.views.detach().cpu().flatten(0, 1)
    middles = _centred(found)[:, None] + found.expected
    samples = [
        displacements.read_patches(
            views,
            found.patches,
            found.expected + offsets[c] + sizes[c] * middles + disparities[c] * found.places,
            [c],
        )
        for c in range(views.shape[1])
    ]
    return displacements.observed(torch.cat(samples, 2), found.seen.shown)


def _centred(found: Registration) -> Tensor:
    """Middles of the patches from the picture's centre, [K, 2]."""
    return found.patches.centres - (torch.tensor(found.field.size) - 1) / 2


def _disparities(found: Registration, seen: Observed) -> tuple[Tensor, Tensor]:
    """Of each patch and channel along rows and columns, and their precisions, [K, C, 2]."""
    places, trust = found.places, found.solved.trust
    inner = torch.einsum("ki,ia,kcab,ib->kcab", trust, places, seen.information, places)
    own = torch.einsum("ki,ia,kica->kca", trust, places, seen.moments)
    noise = registration.noise_of(seen)
    values = torch.linalg.solve(displacements.ridged(inner), own)
    return values, inner.diagonal(dim1=-2, dim2=-1) / noise[..., None]


def _axial(disparities: Tensor, precision: Tensor, channel: int) -> Fitted:
    middle = middle_of(disparities.shape[1])
    if channel == middle:
        return _none(1)
    differences = disparities[:, channel] - disparities[:, middle]
    variance = (1 / precision[:, [channel, middle]].clamp(min=FAINT)).sum(1) + LEAST_ERROR**2
    model = torch.ones(*differences.shape, 1, dtype=differences.dtype)
    return displacements.fitted(model, differences, torch.diag_embed(1 / variance))


def _lateral(found: Registration, templates: Tensor, channel: int) -> Fitted:
    middle = middle_of(templates.shape[1])
    if channel == middle:
        return _none(3)
    information, moved = _compared(templates[:, channel], templates[:, middle])
    model = torch.cat([torch.eye(2, dtype=moved.dtype).expand(len(moved), 2, 2), _centred(found)[..., None]], -1)
    return displacements.fitted(model, moved, information)


def _compared(templates: Tensor, others: Tensor) -> tuple[Tensor, Tensor]:
    """How far templates lie beside others of another colour, [K, h, w] each: information [K, 2, 2], moved [K, 2]."""
    light, *slopes = displacements.texture(templates).double().unbind(-1)
    other, *other_slopes = displacements.texture(others).double().unbind(-1)
    power = other.square().sum(-1, keepdim=True).clamp(min=FAINT)
    contrast = (light * other).sum(-1, keepdim=True) / power
    contrast = torch.where(contrast.abs() < FAINTEST, FAINTEST, contrast)
    # The mean of both gradients errs in the third order of the distance only.
    gradients = torch.stack([(a / contrast + b) / 2 for a, b in zip(slopes, other_slopes, strict=True)], -1)
    gradients = gradients - other[..., None] * ((other[..., None] * gradients).sum(1, keepdim=True) / power[..., None])
    information = gradients.mT @ gradients
    moments = -(gradients * (light / contrast)[..., None]).sum(1)
    moved = torch.linalg.solve(displacements.ridged(information), moments)
    rest = (light / contrast - other).square().mean(-1) - (moved * moments).sum(-1) / light.shape[-1]
    noise = rest.clamp(min=0) + UNEXPLAINED**2 * power[:, 0] / light.shape[-1] + FAINT
    return registration.limited(information / noise[:, None, None]), moved


def _none(n_values: int) -> Fitted:
    nothing = torch.zeros(n_values, dtype=torch.float64)
    return Fitted(nothing, nothing, 0.0, 0.0)


SHOWN = 0.02  # pixels that colours lie apart, on the average over the picture or in the outermost view
SURE = 4.0  # standard errors
CLEAR = {"lateral": 0.6, "axial": 1.0}  # of the scatter of patches: textures of two colours lie apart here and there
LEAST_OFFSET = 0.03  # pixels


@dataclass(frozen=True, eq=False)
class Chromatic:
    """How each channel differs from the middle one."""

    name: ClassVar[str] = "chromatic"

    magnifications: Tensor
    """About the picture's centre, 1 where none is sure, float64, [C]."""
    offsets: Tensor
    """Down and right in pixels, 0 where none is sure, [C, 2]."""
    disparities: Tensor
    """Added to those of the scene, in pixels per view step, 0 where none is sure, [C]."""
    reason: str = ""
    """Why nothing was looked for, if so."""

    def inert(self) -> str | None:
        """Nothing moves where no colour surely differs."""
        if bool((self.magnifications != 1).any() | (self.offsets != 0).any() | (self.disparities != 0).any()):
            return None
        return self.reason or "colours agree in size and focus as far as can be told"

    def told(self) -> str:
        """What each channel differs in."""
        return "; ".join(filter(None, map(self._of_channel, range(len(self.magnifications))))) + (
            "; what all colours share cannot be known"
        )

    def corrected(self, field: LightField) -> LightField:
        """Channels in the size and focus of the middle one."""
        rows, columns = resampling.centred(field.size)
        sizes = self.magnifications[:, None]
        shifts = self.offsets + self.disparities[:, None] * places_of(field).unflatten(0, field.grid)[:, :, None]
        down, right = shifts[..., None, :].unbind(-1)
        return resampling.moved(field, sizes * rows + down, sizes * columns + right)

    def _of_channel(self, channel: int) -> str:
        size, disparity = float(self.magnifications[channel]), float(self.disparities[channel])
        offset = self.offsets[channel].tolist()
        parts = [f"{size:.5f} times the size"] if size != 1 else []
        parts += [f"({offset[0]:+.3f}, {offset[1]:+.3f}) px beside"] if any(offset) else []
        parts += [f"disparities {disparity:+.4f} px per view"] if disparity else []
        return f"channel {channel} has {', '.join(parts)}" if parts else ""


def find(evidence: Evidence) -> Chromatic:
    """Find how colours differ.

    Args:
        evidence: Of the light field.
    """
    n_channels = evidence.field.views.shape[2]
    if n_channels < 2:
        return _nothing(n_channels, "there is one channel")
    found = registered(evidence)
    if found is None:
        return _nothing(n_channels, "too little texture, or too few views, to tell")
    return _found(found)


def _found(found: Registration) -> Chromatic:
    first = dispersions(found, found.seen)
    reach = float(found.places.abs().max())
    lateral = torch.tensor([_is_lateral(one.lateral) for one in first])
    axial = torch.tensor([_is_axial(one.axial, reach) for one in first])
    moved = torch.tensor([_is_beside(one.lateral) for one in first]) & lateral[:, None]
    sure = torch.cat([moved, lateral[:, None], axial[:, None]], 1)
    total = torch.where(sure, _values(first), 0.0)
    for _ in range(ROUNDS if bool(sure.any()) else 0):
        seen = read_again(found, total[:, :2], total[:, 2], total[:, 3])
        total = total + torch.where(sure, _values(dispersions(found, seen)), 0.0)
    return Chromatic(1 + total[:, 2], total[:, :2], total[:, 3])


def _values(found: list[Dispersion]) -> Tensor:
    """Offset down and right, magnification less 1, disparity, [C, 4]."""
    return torch.stack([torch.cat([one.lateral.values, one.axial.values]) for one in found])


def _is_lateral(fit: Fitted) -> bool:
    is_sure = abs(float(fit.values[2])) > SURE * float(fit.errors[2])
    return is_sure and fit.effect > max(SHOWN, CLEAR["lateral"] * fit.scatter)


def _is_beside(fit: Fitted) -> list[bool]:
    return [
        abs(value) > max(LEAST_OFFSET, SURE * error)
        for value, error in zip(fit.values[:2].tolist(), fit.errors[:2].tolist(), strict=True)
    ]


def _is_axial(fit: Fitted, reach: float) -> bool:
    """Whether a disparity of its own shows in views as far as `reach` from the centre."""
    size = abs(float(fit.values[0]))
    is_sure = size > SURE * float(fit.errors[0])
    return is_sure and size * reach > SHOWN and size > CLEAR["axial"] * fit.scatter


def _nothing(n_channels: int, reason: str) -> Chromatic:
    nothing = torch.zeros(n_channels, 2, dtype=torch.float64)
    return Chromatic(1 + nothing[:, 0], nothing, nothing[:, 1].clone(), reason)


CHROMATIC = Correction(Chromatic, "textures that the colours share, in three views or more", find)
