"""What a refiner reads of each plane: a classical picture of it, and what tells where that picture errs.

Every guide is one entry of a table, made of the light field and the slopes alone, so that any view grid, any planes and
any number of them serve. Those of `OFFERS` are other pictures of the same plane, less the classical one: what a refiner
mixes its correction of.
Letters: `N` planes, `C H W` channel, pixel row and column.
"""

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError, chosen
from lfref.functional import noise_line
from lfref.functional.neighbours import binomial, box_max, box_mean
from lfref.lightfield import LightField
from lfref.refocus import apertures
from lfref.refocus.disparity.disparity_map import coarse_disparity
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.through_cells import shift_and_sum_through_cells
from lfref.refocus.surface import per_pixel
from lfref.refocuser import filling
from lfref.refocuser.operators import OperatorRefocuser

# PART seen
# A light field and planes of it, with all that is found out about them: what guides are made of.
#
# Letters: `N` planes, `C H W` channel, pixel row and column, `s` slope, `d` disparity.

POINTS = OperatorRefocuser("points", functools.partial(shift_and_sum, interpolation="cubic"))
"""The plain sum of the views, which the other guides are measured by."""
WINDOW = 5
"""Pixels along the side of what is around a pixel."""
LEAST = 1e-6
"""Light that counts for nothing."""
MOST = 3.0
"""Doubts that no offer goes beyond."""
ROUGHNESS = 1.57
"""Standard deviation of white noise for each unit of what the finest filter takes away of it, in the mean."""
REACHES = (9, 33)
"""Pixels along the sides of squares that surfaces are looked for in."""
SEEN = 1e-3
"""Share of the views that may miss a pixel which all of them see."""
CELLS = OperatorRefocuser("cells", shift_and_sum_through_cells)


Found = TypeVar("Found")


def _once(find: Callable[["Seen"], Found]) -> cached_property[Found]:
    """What is found once for all planes."""

    @functools.wraps(find)
    def found(seen: "Seen") -> Found:
        return find(seen) if seen.among is None else getattr(seen.among, find.__name__)

    return cached_property(found)


def _at_once(find: Callable[["Seen"], Tensor]) -> cached_property[Tensor]:
    """What is found for all planes at once, plane by plane."""

    @functools.wraps(find)
    def found(seen: "Seen") -> Tensor:
        if seen.among is None:
            return find(seen)
        planes: Tensor = getattr(seen.among, find.__name__)
        return planes[seen.first : seen.first + len(seen.slopes)]

    return cached_property(found)


@dataclass(frozen=True, eq=False)
class Seen:
    """A light field and planes of it, with what several guides share, each found when first asked for."""

    light: LightField
    """On an even grid, [V, U, C, H, W]."""
    slopes: Tensor
    """In pixels per view step, float64, [N]."""
    base: OperatorRefocuser
    """Makes the classical pictures."""
    among: "Seen | None" = None
    """More planes, of which these are some; None: these are all."""
    first: int = 0
    """Which of those comes first."""

    @_at_once
    def pictures(self) -> Tensor:
        """The classical pictures, [N, C, H, W]."""
        return self.base.knowing(lambda: self.disparities)(self.light, self.slopes)

    @_once
    def disparities(self) -> Tensor:
        """Of each pixel of the central view, in pixels per view step, [H, W]; 0 where there is but one view."""
        if self.whole.shape[:2].numel() < 2:
            return self.whole.new_zeros(self.light.size)
        return coarse_disparity(self.whole).to(self.whole)

    @_once
    def whole(self) -> Tensor:
        """The views, samples that are not trusted replaced by what the others show there, [V, U, C, H, W]."""
        light = self.light
        return light.views if light.weight is None else filling.filled(light.views, light.weight.to(light.views))

    @_at_once
    def sums(self) -> Tensor:
        """Plain sums of the views, [N, C, H, W]."""
        return self._of(POINTS, self.light)

    @cached_property
    def grey(self) -> LightField:
        """The mean of the colours, [V, U, 1, H, W]."""
        return replace(self.light, views=self.light.views.mean(2, keepdim=True))

    @_at_once
    def spread(self) -> Tensor:
        """Standard deviation over the views that a pixel of a plane is the sum of, grey, [N, 1, H, W]."""
        squares = self._of(POINTS, replace(self.grey, views=self.grey.views.square()))
        return (squares - self.sums.mean(1, keepdim=True).square()).clamp(min=0).sqrt()

    @_at_once
    def inner(self) -> Tensor:
        """What the middle of the aperture, half as wide, sees more than all of it, grey, [N, 1, H, W]."""
        half = POINTS.through(lambda grid: apertures.square(grid, min(grid) / 2))
        return half(self.grey, self.slopes) - self.sums.mean(1, keepdim=True)

    @_at_once
    def cells(self) -> Tensor:
        """Sums of the views as cells of the aperture, [N, C, H, W]."""
        return self._of(CELLS, self.light)

    @cached_property
    def smoother(self) -> tuple[Tensor, Tensor, Tensor]:
        """Pictures through wider and wider binomial filters, about 2, 5 and 9 pixels, [N, C, H, W] each."""
        fine = binomial(self.pictures)
        middle = binomial(fine, 2)
        return fine, middle, binomial(middle, 4)

    @_once
    def noise(self) -> tuple[float, float]:
        """Variance of the views' noise for each unit of light, and in the dark."""
        return noise_line.measured(self.light)

    @cached_property
    def chance(self) -> Tensor:
        """Standard deviation that the noise of the views leaves in pictures, [N, 1, H, W].

        Never more than is rough about a picture, nor than the views differ by.
        """
        shot, read = self.noise
        light, n_views = self.pictures.mean(1, keepdim=True).clamp(min=0), self._n_views()
        told = ((shot * light + read) / n_views).sqrt()
        rough = ROUGHNESS * _around((self.pictures - self.smoother[0]).abs().mean(1, keepdim=True))
        # The spread is grey, which noise of its own in each colour is less than that of a colour in.
        apart = math.sqrt(self.light.views.shape[2] / n_views) * _around(self.spread)
        return told.minimum(rough).minimum(apart)

    @cached_property
    def doubt(self) -> Tensor:
        """How far a picture may be off, [N, 1, H, W]: as its noise, and as far as the nearer one of two others is.

        Where not all views see a pixel there is more that nobody can know: pictures are left as they are, and their
        doubt is 0.
        """
        apart = [(other - self.pictures).abs() for other in self._others()]
        nearer = _around(functools.reduce(torch.minimum, apart).mean(1, keepdim=True))
        return nearer.hypot(self.chance) * (self.coverage > 1 - SEEN)

    @_once
    def is_one(self) -> tuple[bool, bool]:
        """Whether the classical pictures are the sums, or the sums of cells."""
        return torch.equal(self.pictures, self.sums), torch.equal(self.pictures, self.cells)

    def _others(self) -> Sequence[Tensor]:
        """What the pictures are measured by: a method that makes one of these itself, by the other."""
        both = (self.sums, self.cells)
        return [each for each, is_itself in zip(both, self.is_one, strict=True) if not is_itself] or both

    def of_doubt(self, difference: Tensor) -> Tensor:
        """A difference in units of the doubt, large ones as their logarithm: alike for clean scenes and others.

        Args:
            difference: In light, [N, channels, H, W].
        """
        doubts = difference / (self.doubt + LEAST)
        # The area hyperbolic sine, which PyTorch takes ten times as long for.
        return (doubts.abs() + (doubts.square() + 1).sqrt()).log().copysign(doubts)

    def offered(self, other: Tensor) -> Tensor:
        """Another picture less the classical one, in units of the doubt; none goes beyond `MOST`.

        Args:
            other: In light, [N, C, H, W].
        """
        difference = other - self.pictures
        return difference / (self.doubt + LEAST + difference.abs() / MOST)

    def parts(self, n_planes: int) -> Iterator["Seen"]:
        """Some of the planes after the others; what is found of all of them is found once.

        Args:
            n_planes: In each, if there are as many.
        """
        for first in range(0, len(self.slopes), n_planes):
            yield replace(self, slopes=self.slopes[first : first + n_planes], among=self, first=first)

    @property
    def fraction(self) -> Tensor:
        """How far slopes are from whole ones, at which no view is read between its pixels, 0 to 1, [N, 1, 1, 1]."""
        return 2 * (self.slopes - self.slopes.round()).abs().to(self.light.views)[:, None, None, None]

    @cached_property
    def defocus(self) -> Tensor:
        """How far each pixel of the central view is from each plane, s - d, [N, 1, H, W]."""
        return self.slopes.to(self.disparities)[:, None, None, None] - self.disparities

    @_once
    def relief(self) -> Tensor:
        """By how much disparities vary within each of `REACHES`, in pixels per view step, [1, 2, H, W]."""
        return torch.cat([_range(self.disparities[None, None], reach) for reach in REACHES], 1)

    @_once
    def central(self) -> Tensor:
        """The view in the middle, [C, H, W]; where none stands there, those around it, each pixel from where it is."""
        rows, columns = (slice((n_views - 1) // 2, n_views // 2 + 1) for n_views in self.light.grid)
        middle = self.whole[rows, columns]
        if middle.shape[:2].numel() == 1:
            return middle[0, 0]
        return per_pixel(middle, self.disparities, "cubic", border="edge")[0]

    @_at_once
    def coverage(self) -> Tensor:
        """Share of the views that see a pixel of a plane within their frame, [N, 1, H, W]."""
        rows, columns = (
            self._inside(n_views, n_pixels) for n_views, n_pixels in zip(self.light.grid, self.light.size, strict=True)
        )
        return rows[:, None, :, None] * columns[:, None, None, :]

    def _inside(self, n_views: int, n_pixels: int) -> Tensor:
        """Share of the views along one axis within whose frame pixels lie, [N, n_pixels]."""
        steps = geometry.angular_offsets(n_views).to(self.slopes)
        read = torch.arange(n_pixels).to(self.slopes) + (self.slopes[:, None] * steps)[..., None]
        inside = ((read > -1) & (read < n_pixels)).to(self.light.views)
        return inside.mean(1)

    def _n_views(self) -> float:
        """As many views of equal weight leave as much noise as the aperture does."""
        if self.base.aperture is None:
            return float(math.prod(self.light.grid))
        weights = self.base.aperture(self.light.grid)
        return float(weights.sum().square() / weights.square().sum())

    def _of(self, operator: OperatorRefocuser, light: LightField) -> Tensor:
        """Through the aperture of the classical pictures, if they have one."""
        return operator.through(self.base.aperture)(light, self.slopes)


def _around(images: Tensor) -> Tensor:
    """The mean of what is around each pixel, [N, channels, H, W]."""
    return box_mean(images, WINDOW)


def _range(images: Tensor, reach: int) -> Tensor:
    """Largest less smallest value within a square around each pixel, [N, channels, H, W]."""
    return box_max(images, reach) + box_max(-images, reach)


OFFERS: dict[str, Callable[[Seen], Tensor]] = {
    "fine": lambda seen: seen.offered(seen.smoother[0]),
    "middle": lambda seen: seen.offered(seen.smoother[1]),
    "coarse": lambda seen: seen.offered(seen.smoother[2]),
    "sum": lambda seen: seen.offered(seen.sums),
    "cells": lambda seen: seen.offered(seen.cells),
    "central": lambda seen: seen.offered(seen.central),
}
"""Each (seen) -> [N, C, H, W], in units of the doubt."""

GUIDES: dict[str, Callable[[Seen], Tensor]] = OFFERS | {
    "picture": lambda seen: seen.pictures - 0.5,
    "inner": lambda seen: seen.of_doubt(seen.inner) / 3,
    "spread": lambda seen: seen.of_doubt(seen.spread) / 3,
    "defocus": lambda seen: torch.cat([seen.defocus.tanh(), (0.3 * seen.defocus.abs()).tanh()], 1),
    "relief": lambda seen: seen.relief.tanh().expand(len(seen.pictures), -1, -1, -1),
    "coverage": lambda seen: 2 * (1 - seen.coverage),
    "fraction": lambda seen: seen.fraction.expand_as(seen.spread),
    "views": lambda seen: torch.full_like(seen.spread, math.log2(math.prod(seen.light.grid)) / 3 - 2),
    "doubt": lambda seen: (seen.doubt + LEAST).log10() / 2 + 1.5,
    "chance": lambda seen: (seen.chance + LEAST).log10() / 2 + 1.5,
}
"""Each (seen) -> [N, channels, H, W], of the order of 1."""


def check(names: Sequence[str], n_offers: int) -> None:
    """Refuse guides that a refiner could not mix its corrections of.

    Args:
        names: Of the guides.
        n_offers: How many of them it takes for offers: the first ones.

    Raises:
        InputError: They are no offers.
    """
    first = tuple(names)[:n_offers]
    if len(first) < n_offers or not set(first) <= set(OFFERS):
        remedy = "order the guides of the recipe, or set net.n_offers"
        raise InputError(f"the first {n_offers} guides must be among {', '.join(OFFERS)}", got=first, remedy=remedy)


def guides(seen: Seen, names: Sequence[str], dtype: torch.dtype = torch.float32) -> Tensor:
    """What a refiner reads of planes.

    Args:
        seen: A light field and planes of it.
        names: Of `GUIDES`.
        dtype: Of the guides.

    Returns:
        Guides one after the other, [N, channels, H, W].

    Raises:
        InputError: There is no such guide.
    """
    return torch.cat([chosen("guide", name, GUIDES)(seen).to(dtype) for name in names], 1)
