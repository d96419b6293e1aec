"""Displacements of patches in views, explained by a shift of each view and disparities of each patch.

Least squares; what is far out loses its say. Letters: `k` patch, `i` view.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from lfref.captures import displacements
from lfref.captures.displacements import FAINT

ROUNDS = 4  # in which outliers lose their say
OUTLYING = 2.0  # standard deviations at which a displacement counts half
LOOSE = 0.3  # pixels: standard deviation of shifts before anything is known


class Explained(NamedTuple):
    """What explains displacements best."""

    shifts: Tensor
    """Of views, (down, right) in pixels, float64, [I, 2]."""
    disparities: Tensor
    """Of patches, along rows and along columns, in pixels per view step, [K, 2]."""
    precision: Tensor
    """Of these, inverse of their variance, [K, 2]."""
    trust: Tensor
    """How far each displacement counted, [0, 1], [K, I]."""


class _Normal(NamedTuple):
    """Normal equations, disparities eliminated."""

    shifts: Tensor
    disparities: Tensor
    inner: Tensor


def explained(information: Tensor, moved: Tensor, shown: Tensor, places: Tensor, unknown: Tensor) -> Explained:
    """Find shifts and disparities.

    Args:
        information: Of patches, in inverse square pixels, [K, 2, 2].
        moved: Their displacements (down, right) in pixels, [K, I, 2].
        shown: 1 where a view shows a patch, else 0, [K, I].
        places: Of views, (v, u) in view steps, [I, 2].
        unknown: Shifts that are left at 0, orthonormal, [2I, M].
    """
    trust = shown
    for _ in range(ROUNDS):
        found = _least_squares(trust[..., None, None] * information[:, None], moved, places, unknown)
        left = moved - found.shifts - found.disparities[:, None] * places
        outlying = ((left @ information) * left).sum(-1)
        usual = outlying[shown > 0].median() if bool(shown.any()) else outlying.median()
        trust = shown / (1 + outlying / (OUTLYING**2 * usual.clamp(min=FAINT)))
    precision = found.inner.diagonal(dim1=-2, dim2=-1) / usual.clamp(min=FAINT)
    return Explained(found.shifts, found.disparities, precision, trust)


def _least_squares(weights: Tensor, moved: Tensor, places: Tensor, unknown: Tensor) -> _Normal:
    """From weights of displacements, [K, I, 2, 2]."""
    n_views = len(places)
    right = (weights @ moved[..., None])[..., 0]
    cross = weights * places[:, None]  # by shift and disparity
    inner = displacements.ridged(torch.einsum("ia,kiab->kab", places, cross))
    own = (right * places).sum(1)
    columns = cross.flatten(1, 2)
    onto = torch.linalg.solve(inner, columns.mT)
    curvature = torch.block_diag(*weights.sum(0)) - torch.einsum("kxb,kby->xy", columns, onto)
    curvature = curvature + torch.eye(2 * n_views, dtype=weights.dtype) / LOOSE**2
    curvature = curvature + curvature.diagonal().mean() * (unknown @ unknown.mT)
    slope = right.sum(0).flatten() - torch.einsum("kby,kb->y", onto, own)
    shifts = torch.linalg.solve(curvature, slope).unflatten(0, (n_views, 2))
    rest = own - torch.einsum("kiab,ia->kb", cross, shifts)
    return _Normal(shifts, torch.linalg.solve(inner, rest), inner)


def linear(places: Tensor) -> Tensor:
    """Shifts of all views alike, and linear in their places: of length 1, [2I, 6].

    Args:
        places: Of views, (v, u) in view steps, [I, 2].
    """
    eye = torch.eye(2, dtype=places.dtype)
    around = places - places.mean(0)
    crossed = (around.flip(-1)[:, :, None] * eye).flatten(0, 1)
    return torch.cat([proportional(places), crossed / crossed.norm(dim=0).clamp(min=FAINT)], 1)


def proportional(places: Tensor) -> Tensor:
    """Shifts of all views alike, and in proportion to their places along each axis: of length 1, [2I, 4].

    Args:
        places: Of views, (v, u) in view steps, [I, 2].
    """
    eye = torch.eye(2, dtype=places.dtype)
    around = (places - places.mean(0))[:, :, None] * eye
    modes = torch.cat([eye.expand(len(places), 2, 2), around], -1).flatten(0, 1)
    return modes / modes.norm(dim=0).clamp(min=FAINT)
