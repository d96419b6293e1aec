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
from lfref.captures import displacements, patches
from lfref.captures.displacements import FAINT, Observed
from lfref.captures.evidence import Evidence
from lfref.captures.explained import Explained, explained, linear
from lfref.captures.patches import Patches
from lfref.lightfield import LightField

ROUNDS = 4  # of reading patches where they now seem to lie
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
    if len(views) < 3 or min(field.size) < 4 * patches.SIDE:
        return None
    places = places_of(field)
    row, column = evidence.reference
    found = patches.chosen(
        field.views[row, column].cpu().float().mean(0), evidence.disparity.cpu(), places, views.shape[1]
    )
    if len(found.rows) < FEWEST_PATCHES:
        return None
    shown = _shown(field, found, places)
    expected = found.disparity[:, None, None] * places
    for _ in range(ROUNDS):
        read_at = expected
        seen = displacements.observed(patches.read(views, found, read_at), shown)
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
    half = patches.SIDE / 2
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
    noise = seen.rest.median(1).values / patches.SIDE**2
    texture = seen.templates.var((-2, -1)).double()
    return noise + noise.median(0).values.clamp(min=FAINT) + UNEXPLAINED**2 * texture


def limited(information: Tensor) -> Tensor:
    """Information [..., 2, 2] without what it cannot hold: bent surfaces, highlights, interpolation."""
    values, vectors = torch.linalg.eigh(information)
    sure = (values - STRIPES * values[..., 1:]).clamp(min=0)
    sure = sure / (1 + SYSTEMATIC**2 * sure)
    return (vectors * sure[..., None, :]) @ vectors.mT
