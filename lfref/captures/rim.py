"""The rim of a lens: light that falls off towards the corners, and a pupil that is clipped there (cat's eye).

A disc as wide as the lens lets views through; off the axis it is displaced, and a view counts by the share of its cell
that lies within. On top of that all views lose light by cos^4 of the field angle. Where a scene has depth, that loss
shows too: a point lies elsewhere in each view.
Letters: `y x` place in half diagonals from the picture's centre, `q p` view row and column from the angular centre,
`r` distances, `n` windows.
Source: Goldman and Chen, "Vignette and Exposure Calibration and Compensation", 2005 (moving pictures tell falloff).
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.captures.brightness import LEAST_RATIO, Ratios

STARTS = (0.0, 0.12, 0.25, 0.4, 0.6, 0.85, 1.2)  # displacements at the corner tried first, in radii of the grid
SIZES = (1.0, 0.9, 0.8, 0.7, 0.6)  # radii tried first, likewise
BEST = 3  # starts that are followed
ROUNDS = 8
SOME = 2  # every so many views are looked at by all starts
FEWEST = 8  # windows of a view from which its exposure is known
STEP = 1e-3  # for differences by each parameter
LONGEST = (0.1, 0.3, 0.3)  # changes in one round
BOUNDS = ((-0.2, 3.0), (0.0, 20.0), (0.5, 100.0))
TILES = 6  # a side, that are taken to err on their own


class Rim(NamedTuple):
    """The lens; in the order of the fit's parameters."""

    falloff: float = 0.0
    """Square of the tangent of the field angle at the picture's corner."""
    displacement: float = 0.0
    """Of the rim at the picture's corner, in view steps."""
    radius: float = 1e3
    """Of the rim, in view steps."""


class Fit(NamedTuple):
    """A rim, and how sure it is."""

    rim: Rim
    gain: float
    """How much better than a pupil that is not clipped it explains the views: squared scatters a window, in the second
    worst of the picture's four quarters."""
    falloff_error: float
    """Standard error of the falloff, from how far tiles of the picture disagree."""


def clipped(rim: Rim, y: Tensor, x: Tensor, q: Tensor, p: Tensor) -> Tensor:
    """Share of each view that the rim lets through, over that in the centre of the view, [0, 1].

    Args:
        rim: The lens.
        y: Rows, any shape.
        x: Columns, likewise.
        q: View rows, likewise.
        p: View columns, likewise.
    """
    distance = torch.hypot(q - rim.displacement * y, p - rim.displacement * x)
    own = (rim.radius + 0.5 - torch.hypot(q, p)).clamp(LEAST_RATIO, 1)
    return ((rim.radius + 0.5 - distance) / own).clamp(0, 1)


def fallen(rim: Rim, y: Tensor, x: Tensor) -> Tensor:
    """Share of the light that falloff leaves in all views, (0, 1]; arguments as for `clipped`."""
    return (1 + rim.falloff * (y.square() + x.square())).clamp(min=0.1) ** -2


def fit(ratios: Ratios, scatter: float) -> Fit:
    """Find the rim that explains best how brightness changes from view to view.

    Args:
        ratios: Of the light field.
        scatter: Standard deviation of their logarithms from window to window.
    """
    scale = 2 * max(scatter, 1e-3)
    some = _Problem(ratios, scale, SOME)
    starts = sorted(_starts(ratios), key=some.cost)
    if not starts[0].displacement:
        return Fit(Rim(), 0.0, math.inf)
    problem = _Problem(ratios, scale)
    rim = min((_refined(problem, start) for start in starts[:BEST]), key=problem.cost)
    return Fit(rim, problem.gain(rim), problem.falloff_error(rim))


def _starts(ratios: Ratios) -> list[Rim]:
    radius = math.hypot(*ratios.known.shape[:2]) / 2
    starts = [Rim(0.0, share * radius, size * radius) for size in SIZES for share in STARTS if share]
    return [Rim(0.0, 0.0, radius), *starts]


class _Problem:
    """Logarithms of brightness to be explained, [VU, n]; what each view has everywhere is its exposure."""

    def __init__(self, ratios: Ratios, scale: float, step: int = 1) -> None:
        views = slice(None, None, step)
        known = ratios.known.flatten(0, 1)[views]
        self.known = known & (known.sum(1, keepdim=True) > FEWEST)
        self.log, self.scale = ratios.log.mean(2).flatten(0, 1)[views], scale
        self.y, self.x = ratios.places.flatten(1, 2)[:, views]
        self.q, self.p = ratios.views.flatten(1, 2)[:, views]
        self.y0, self.x0 = ratios.places[(slice(None), *ratios.centre)]
        self.q0, self.p0 = ratios.views[(slice(None), *ratios.centre)]

    def explained(self, rim: Rim) -> Tensor:
        """Logarithm of each view's gain over that of the central view, [VU, n]."""
        own = _log(clipped(rim, self.y, self.x, self.q, self.p)) + _log(fallen(rim, self.y, self.x))
        central = _log(clipped(rim, self.y0, self.x0, self.q0, self.p0)) + _log(fallen(rim, self.y0, self.x0))
        return (own - central).clamp(min=math.log(LEAST_RATIO))

    def rest(self, rim: Rim) -> tuple[Tensor, Tensor]:
        """What is not explained, and how far each counts: outliers, such as highlights, do not, [VU, n] each."""
        rest = self.log - self.explained(rim)
        exposure = torch.where(self.known, rest, torch.nan).nanmedian(1, keepdim=True).values.nan_to_num()
        rest = torch.where(self.known, rest - exposure, 0.0)
        weight = self.known / (1 + (rest / self.scale).square()).square()
        mean = (weight * rest).sum(1, keepdim=True) / weight.sum(1, keepdim=True).clamp(min=1e-6)
        return rest - mean * self.known, weight

    def costs(self, rim: Rim) -> Tensor:
        """Squared scatters of each window, none counting for more than 1 in any view, [n]."""
        square = (self.rest(rim)[0] / self.scale).square()
        return (self.known * square / (1 + square)).sum(0) / self.known.sum(0).clamp(min=1)

    def cost(self, rim: Rim) -> float:
        """Of all windows."""
        return float(self.costs(rim).sum())

    def gain(self, rim: Rim) -> float:
        """As in `Fit`."""
        won = self.costs(rim._replace(displacement=0.0)) - self.costs(rim)
        quarter = 2 * (self.y0 > 0) + (self.x0 > 0)
        counts = self.known.any(0)
        sums = [(won * counts)[quarter == i].sum() / max(1, int(counts[quarter == i].sum())) for i in range(4)]
        return float(torch.stack(sums).sort().values[1])

    def slopes(self, rim: Rim, weight: Tensor) -> Tensor:
        """Derivatives of what is explained, less their mean over each view, [3, VU, n]."""
        here, total = self.explained(rim), weight.sum(1, keepdim=True).clamp(min=1e-6)
        moved = [rim._replace(**{name: value + STEP}) for name, value in zip(Rim._fields, rim, strict=True)]
        slopes = torch.stack([(self.explained(each) - here) / STEP for each in moved])
        return slopes - (weight * slopes).sum(2, keepdim=True) / total

    def falloff_error(self, rim: Rim) -> float:
        """As in `Fit`."""
        rest, weight = self.rest(rim)
        slopes = self.slopes(rim, weight)
        pulls = torch.einsum("ivn,vn->in", slopes, weight * rest)
        tile = ((self.y0 + 1) * TILES / 2).long() * TILES + ((self.x0 + 1) * TILES / 2).long()
        sums = torch.zeros(3, TILES**2).to(pulls).index_add(1, tile.clamp(0, TILES**2 - 1), pulls)
        moves = torch.linalg.pinv(_squares(slopes, weight).double()) @ sums.double()
        return float(moves[0].square().sum().sqrt())


def _refined(problem: _Problem, rim: Rim) -> Rim:
    """A rim moved downhill by rounds of weighted least squares."""
    for _ in range(ROUNDS):
        rest, weight = problem.rest(rim)
        slopes = problem.slopes(rim, weight)
        pull = torch.einsum("ivn,vn->i", slopes, weight * rest).double()
        move = torch.linalg.pinv(_squares(slopes, weight).double(), rtol=1e-8) @ pull
        values = [
            min(max(value + min(max(float(step), -most), most), low), high)
            for value, step, most, (low, high) in zip(rim, move, LONGEST, BOUNDS, strict=True)
        ]
        rim = Rim(*values)
    return rim


def _squares(slopes: Tensor, weight: Tensor) -> Tensor:
    return torch.einsum("ivn,jvn,vn->ij", slopes, slopes, weight)


def _log(gain: Tensor) -> Tensor:
    return gain.clamp(min=LEAST_RATIO).log()
