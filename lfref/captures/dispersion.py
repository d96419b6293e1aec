"""How the colours of a light field differ in size and in focus.

Channel c shows at `m_c y + t_c + d_c p` what the middle channel shows at y: m magnification about the picture's centre,
t an offset, d an added disparity. Disparities of a channel come from its own patches in all views; sizes and offsets
from a comparison of each channel's mean over the views with that of the middle one.
Letters: `k` patch, `i` view, `c` channel, `p` place of a view, `y x` pixel row and column from the centre.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from lfref.captures import displacements, fitted, patches, registration
from lfref.captures.displacements import FAINT, Observed
from lfref.captures.fitted import Fitted
from lfref.captures.registration import Registration

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
        patches.read(
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
    return fitted.fitted(model, differences, torch.diag_embed(1 / variance))


def _lateral(found: Registration, templates: Tensor, channel: int) -> Fitted:
    middle = middle_of(templates.shape[1])
    if channel == middle:
        return _none(3)
    information, moved = _compared(templates[:, channel], templates[:, middle])
    model = torch.cat([torch.eye(2, dtype=moved.dtype).expand(len(moved), 2, 2), _centred(found)[..., None]], -1)
    return fitted.fitted(model, moved, information)


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
