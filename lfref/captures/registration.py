"""Where the views of a light field really lie: displacements of small patches, explained by views and by disparities.

Patch k of view i shows `f_k(x - D_k p_i - s_i)`: texture f, disparity D of rows and of columns, place p of the view
from the angular centre, shift s of the view. What cannot be known is left at 0: the mean of all shifts (where the scene
is), and shifts in proportion to p along rows and along columns (disparities that all of the scene has more).
Letters: `k` patch, `i` view, `c` channel.
"""

from typing import NamedTuple
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from lfref import geometry
from lfref.captures import displacements
from lfref.captures.defect import Evidence
from lfref.captures.displacements import FAINT, Observed, Patches
from lfref.lightfield import LightField

# PART explained
# Displacements of patches in views, explained by a shift of each view and disparities of each patch.
#
# Least squares; what is far out loses its say. Letters: `k` patch, `i` view.

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


# of reading patches where they now seem to lie
SETTLED = 0.08  # pixels: patches that moved less need not be read again
FEWEST_PATCHES = 12
OPEN = 0.5  # weight from which a view shows a patch
UNEXPLAINED = 0.01  # of a patch's contrast, at the least
STRIPES = 0.01  # of the strongest texture: what is fainter across it may be a trace of it
SYSTEMATIC = 0.02  # pixels: no patch is better than that, however fine its texture

_KNOWN: "WeakKeyDictionary[Evidence, Registration | None]" = WeakKeyDictionary()


class Registration(NamedTuple):
    """Patches, what was seen of them, and what explains it."""

    field: LightField
    patches: Patches
    places: Tensor
    """Of all views from the angular centre, (v, u) in view steps, float64, [I, 2]."""
    expected: Tensor
    """Where they were read in each view, from their places in the central one, in pixels, [K, I, 2]."""
    seen: Observed
    """Displacements from there."""
    solved: Explained

    def again(self, unknown: Tensor, chosen: Tensor | slice = slice(None)) -> Explained:
        """What explains some of the patches, or all, where other shifts are left at 0; see `explained`."""
        information, moved, shown = weighed(self.seen.moved(self.expected))
        return explained(information[chosen], moved[chosen], shown[chosen], self.places, unknown)

    def quarters(self) -> list[Tensor]:
        """Which patches lie in each quarter of the picture, [K] of bool each: up to four looks at the same views."""
        low, right = (self.patches.centres > self.patches.centres.median(0).values).unbind(-1)
        quarters = [low & right, low & ~right, ~low & right, ~low & ~right]
        return [quarter for quarter in quarters if bool(quarter.any())]


def registered(evidence: Evidence) -> Registration | None:
    """Explain the displacements of patches; found once for an evidence.

    Args:
        evidence: Of a light field.

    Returns:
        None where there are too few views or patches.
    """
    if evidence not in _KNOWN:
        _KNOWN[evidence] = _registered(evidence)
    return _KNOWN[evidence]


def _registered(evidence: Evidence) -> Registration | None:
    field, views = evidence.field, evidence.field.views.detach().cpu().flatten(0, 1)
    if len(views) < 3 or min(field.size) < 4 * displacements.SIDE:
        return None
    places = places_of(field)
    row, column = evidence.reference
    found = displacements.chosen(
        field.views[row, column].cpu().float().mean(0), evidence.disparity.cpu(), places, views.shape[1]
    )
    if len(found.rows) < FEWEST_PATCHES:
        return None
    shown = _shown(field, found, places)
    expected = found.disparity[:, None, None] * places
    for _ in range(ROUNDS):
        read_at = expected
        seen = displacements.observed(displacements.read_patches(views, found, read_at), shown)
        solved = explained(*weighed(seen.moved(read_at)), places, linear(places))
        expected = solved.disparities[:, None] * places + solved.shifts
        if float((expected - read_at).abs().amax((1, 2)).median()) < SETTLED:
            break
    return Registration(field, found, places, read_at, seen, solved)


def places_of(field: LightField) -> Tensor:
    """Places of the views from the angular centre, (v, u) in view steps, float64, [V U, 2].

    Args:
        field: On an even grid, or with positions.
    """
    positions = getattr(field, "positions", None)
    if positions is not None:
        return positions.double().cpu().flatten(0, 1)
    return torch.cartesian_prod(*(geometry.angular_offsets(n) for n in field.grid)).reshape(-1, 2)


def _shown(field: LightField, found: Patches, places: Tensor) -> Tensor:
    """1 where a view counts throughout a patch, as far as the patch's corners and middle tell, [K, I]."""
    if field.weight is None:
        return torch.ones(len(found.rows), len(places), dtype=torch.float64)
    weight = field.weight.cpu().flatten(0, 2)
    middles = found.centres[:, None] + found.disparity[:, None, None] * places
    half = displacements.SIDE / 2
    steps = half * torch.tensor([[0, 0], [-1, -1], [-1, 1], [1, -1], [1, 1]], dtype=torch.float64)
    last = torch.tensor(field.size) - 1
    at = torch.minimum((middles[:, :, None] + steps).round().long().clamp(min=0), last)
    view = torch.arange(len(places))[:, None]
    return (weight[view, at[..., 0], at[..., 1]].amin(-1) >= OPEN).double()


def weighed(seen: Observed) -> tuple[Tensor, Tensor, Tensor]:
    """All channels of patches together, by their noise.

    Args:
        seen: Of patches.

    Returns:
        Information [K, 2, 2], displacements [K, I, 2], and which of them count [K, I].
    """
    noise = noise_of(seen)
    together = (seen.information / noise[..., None, None]).sum(1)
    moments = (seen.moments / noise[:, None, :, None]).sum(2)
    moved = moments @ displacements.ridged(together).inverse()
    return limited(together), moved, seen.shown


def noise_of(seen: Observed) -> Tensor:
    """Variance of samples that displacements do not explain, of patches and channels, [K, C]."""
    noise = seen.rest.median(1).values / displacements.SIDE**2
    texture = seen.templates.var((-2, -1)).double()
    return noise + noise.median(0).values.clamp(min=FAINT) + UNEXPLAINED**2 * texture


def limited(information: Tensor) -> Tensor:
    """Information [..., 2, 2] without what it cannot hold: bent surfaces, highlights, interpolation."""
    values, vectors = torch.linalg.eigh(information)
    sure = (values - STRIPES * values[..., 1:]).clamp(min=0)
    sure = sure / (1 + SYSTEMATIC**2 * sure)
    return (vectors * sure[..., None, :]) @ vectors.mT
