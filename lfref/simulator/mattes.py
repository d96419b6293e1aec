"""Outlines of surfaces: signed distances, and the opacity that they give.

An edge is one pixel wide: opacity = 0.5 - distance between 0 and 1, which is the part of a pixel that a straight edge
along its rows or columns leaves covered, and keeps areas. Distances are in pixels of the central view, below 0 inside;
they need to be right only within a pixel of the edge. Letters: `X Y` as in `surfaces`, `h w` rows and columns.
"""

import abc
import functools
import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.simulator import checks
from lfref.simulator.canvases import Box

EDGE = 0.5
"""Half the width of an edge in pixels."""

Segment = tuple[float, float, float, float]
"""A straight line from (X, Y) to (X, Y)."""


class Outline(abc.ABC):
    """A surface's outline."""

    @abc.abstractmethod
    def distance(self, x: Tensor, y: Tensor) -> Tensor:
        """Signed distance from the edge in pixels, below 0 inside.

        Args:
            x: X of the columns, [w].
            y: Y of the rows, [h].

        Returns:
            Distances, [h, w].
        """

    def box(self) -> Box | None:
        """What encloses the surface with its edge; None: it has no end."""
        return None

    def opacity(self, x: Tensor, y: Tensor) -> Tensor:
        """Part of each point that the surface covers, from 0 to 1; arguments as for `distance`."""
        return (EDGE - self.distance(x, y)).clamp(0, 1)


@dataclass(frozen=True)
class Full(Outline):
    """No edge: it covers all there is to see."""

    def distance(self, x: Tensor, y: Tensor) -> Tensor:
        """As in `Outline`; nowhere near an edge."""
        return x.new_full((len(y), len(x)), -math.inf)


@dataclass(frozen=True)
class Disc(Outline):
    """A circle."""

    radius: float
    """In pixels."""
    centre: tuple[float, float] = (0.0, 0.0)
    """(X, Y)."""

    def __post_init__(self) -> None:
        checks.freeze(self)
        checks.numbers("a disc's radius", [self.radius], least=EDGE)
        checks.pair("a disc's centre", self.centre)

    def distance(self, x: Tensor, y: Tensor) -> Tensor:
        """As in `Outline`."""
        return torch.hypot(x - self.centre[0], y[:, None] - self.centre[1]) - self.radius

    def box(self) -> Box:
        """As in `Outline`."""
        return _around([self.centre], self.radius)


@dataclass(frozen=True)
class Polygon(Outline):
    """Straight edges from corner to corner, and back to the first; even-odd where they cross."""

    corners: tuple[tuple[float, float], ...]
    """(X, Y) of each, three at least."""

    def __post_init__(self) -> None:
        checks.freeze(self)
        if len(self.corners) < 3:
            raise InputError("a polygon needs at least three corners", got=self.corners)
        for corner in self.corners:
            checks.pair("a polygon's corners", corner)

    def distance(self, x: Tensor, y: Tensor) -> Tensor:
        """As in `Outline`."""
        nearest = x.new_full((len(y), len(x)), math.inf)
        is_inside = torch.zeros(nearest.shape, dtype=torch.bool, device=x.device)
        for start, end in itertools.pairwise((*self.corners, self.corners[0])):
            nearest = torch.minimum(nearest, _squared_distance((*start, *end), x, y[:, None]))
            is_inside ^= _is_left_of((*start, *end), x, y[:, None])
        return torch.where(is_inside, -nearest.sqrt(), nearest.sqrt())

    def box(self) -> Box:
        """As in `Outline`."""
        return _around(self.corners, 0)


@dataclass(frozen=True)
class Leaf(Outline):
    """A pointed leaf: what two equal circles have in common."""

    length: float
    """From tip to tip in pixels."""
    width: float
    """Across the middle in pixels, less than its length."""
    angle: float = 0.0
    """Of its axis in degrees, from x towards y."""
    centre: tuple[float, float] = (0.0, 0.0)
    """(X, Y)."""

    def __post_init__(self) -> None:
        checks.freeze(self)
        checks.above_zero("a leaf's length and width", self.length, self.width)
        checks.numbers("a leaf's angle", [self.angle])
        checks.pair("a leaf's centre", self.centre)
        if not self.width < self.length:
            raise InputError("a leaf must be longer than wide", got=f"{self.length:g} x {self.width:g}")

    def distance(self, x: Tensor, y: Tensor) -> Tensor:
        """As in `Outline`."""
        turned = _turned(x - self.centre[0], y[:, None] - self.centre[1], self.angle)
        along, across = (offset.abs() for offset in turned)
        radius, half = (self.length**2 + self.width**2) / (4 * self.width), self.length / 2
        to_centre = radius - self.width / 2
        # Beyond the circles' normals at a tip, the tip is nearest.
        is_beyond = (along - half) * to_centre > across * half
        from_arc = torch.hypot(along, across + to_centre) - radius
        return torch.where(is_beyond, torch.hypot(along - half, across), from_arc)

    def box(self) -> Box:
        """As in `Outline`."""
        return _around([self.centre], self.length / 2)


@dataclass(frozen=True)
class Twigs(Outline):
    """Thin branching lines that grow from one point, drawn by a seed."""

    length: float
    """Of the first branch in pixels; each further one is shorter by a third."""
    width: float = 2.0
    """Of all branches in pixels, 1 at least."""
    generations: int = 4
    """How often they branch, from 0 to 6; each branch ends in two."""
    angle: float = -90.0
    """Direction of the first branch in degrees, from x towards y."""
    foot: tuple[float, float] = (0.0, 0.0)
    """(X, Y) where it begins."""
    seed: int = 0
    """Of the branches' directions and lengths."""

    def __post_init__(self) -> None:
        checks.freeze(self)
        checks.above_zero("twigs' length", self.length)
        checks.numbers("twigs' width", [self.width], least=2 * EDGE)
        checks.numbers("twigs' generations", [self.generations], 0, 6)
        checks.numbers("twigs' angle", [self.angle])
        checks.pair("twigs' foot", self.foot)
        checks.numbers("twigs' seed", [self.seed], least=0)

    def distance(self, x: Tensor, y: Tensor) -> Tensor:
        """As in `Outline`; a pixel where no branch is near."""
        result = x.new_full((len(y), len(x)), 2 * EDGE)
        for segment in self.branches():
            left, top, right, bottom = _around([segment[:2], segment[2:]], self.width / 2)
            rows, columns = _between(y, top, bottom), _between(x, left, right)
            near = _squared_distance(segment, x[columns], y[rows, None]).sqrt() - self.width / 2
            result[rows, columns] = torch.minimum(result[rows, columns], near)
        return result

    def box(self) -> Box:
        """As in `Outline`."""
        ends = [end for segment in self.branches() for end in (segment[:2], segment[2:])]
        return _around(ends, self.width / 2)

    @functools.lru_cache(maxsize=64)  # noqa: B019  a few small descriptions
    def branches(self) -> tuple[Segment, ...]:
        """The lines that it consists of, 2^(generations + 1) - 1 of them."""
        random = np.random.default_rng(self.seed)
        return tuple(self._grown(random, *self.foot, math.radians(self.angle), self.length, self.generations))

    def _grown(
        self, random: np.random.Generator, x: float, y: float, angle: float, length: float, generations: int
    ) -> Iterator[Segment]:
        way = length * random.uniform(0.7, 1.0)
        end = (x + way * math.cos(angle), y + way * math.sin(angle))
        yield (x, y, *end)
        for side in (-1, 1) if generations > 0 else ():
            turn = side * random.uniform(0.2, 0.7)
            yield from self._grown(random, *end, angle + turn, length * 2 / 3, generations - 1)


@dataclass(frozen=True)
class Perforated(Outline):
    """No end, but round holes on a square lattice."""

    pitch: float
    """From hole to hole in pixels."""
    radius: float
    """Of a hole in pixels, less than half the pitch."""
    angle: float = 0.0
    """Of the lattice in degrees, from x towards y."""

    def __post_init__(self) -> None:
        checks.numbers("a hole's radius", [self.radius], least=EDGE)
        checks.numbers("holes' pitch and angle", [self.pitch, self.angle])
        if not self.radius <= self.pitch / 2 - EDGE:
            remedy = "half the pitch must be half a pixel more than the radius"
            raise InputError("holes must leave something between them", got=self, remedy=remedy)

    def distance(self, x: Tensor, y: Tensor) -> Tensor:
        """As in `Outline`."""
        along, across = _turned(x, y[:, None], self.angle)
        off = [offset - self.pitch * (offset / self.pitch).round() for offset in (along, across)]
        return self.radius - torch.hypot(*off)


def _around(points: Iterable[tuple[float, float]], radius: float) -> Box:
    xs, ys = zip(*points, strict=True)
    more = radius + EDGE
    return min(xs) - more, min(ys) - more, max(xs) + more, max(ys) + more


def _between(values: Tensor, low: float, high: float) -> slice:
    """Where ascending values lie from `low` to `high`."""
    bounds = torch.tensor([low, high], dtype=values.dtype, device=values.device)
    return slice(*torch.searchsorted(values, bounds).tolist())


def _turned(x: Tensor, y: Tensor, angle: float) -> tuple[Tensor, Tensor]:
    """Coordinates along an axis at that many degrees, and across it."""
    cosine, sine = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    return cosine * x + sine * y, cosine * y - sine * x


def _squared_distance(segment: Segment, x: Tensor, y: Tensor) -> Tensor:
    along_x, along_y = segment[2] - segment[0], segment[3] - segment[1]
    off_x, off_y = x - segment[0], y - segment[1]
    length = max(along_x**2 + along_y**2, 1e-12)
    share = ((off_x * along_x + off_y * along_y) / length).clamp(0, 1)
    return (off_x - share * along_x) ** 2 + (off_y - share * along_y) ** 2


def _is_left_of(segment: Segment, x: Tensor, y: Tensor) -> Tensor:
    """Whether a ray from the point to the right meets the segment."""
    start_x, start_y, end_x, end_y = segment
    if start_y == end_y:
        return torch.zeros(1, dtype=torch.bool, device=x.device)
    crossing = start_x + (y - start_y) * ((end_x - start_x) / (end_y - start_y))
    return ((y < start_y) != (y < end_y)) & (x < crossing)
