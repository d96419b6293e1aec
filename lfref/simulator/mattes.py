"""Mattes: outlines of surfaces, as signed distances from the edge and the opacity that follows from them.

An edge is one pixel wide: opacity = 0.5 - distance, clamped to [0, 1]. For a straight edge along rows or columns, that
is the covered part of the pixel; areas are kept. Distances are in pixels of the central view, below 0 inside; they need
to be right only within a pixel of the edge. Letters: `X Y` as in `surfaces`, `h w` rows and columns.
"""

import abc
import functools
import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.simulator import checks
from lfref.simulator.bitmaps import Box

EDGE = 0.5
"""Half the width of an edge in pixels."""
AtLeastEdge = Annotated[float, EDGE, math.inf]
Segment = tuple[float, float, float, float]


class Outline(checks.Description, abc.ABC):
    """Outline of a surface."""

    @abc.abstractmethod
    def distance(self, x: Tensor, y: Tensor) -> Tensor:
        """Signed distance from the edge at columns X [w] and rows Y [h], in pixels, below 0 inside, [h, w]."""

    def box(self) -> Box | None:
        """The smallest box around the surface with its edge; None for an endless surface."""
        return None

    def opacity(self, x: Tensor, y: Tensor) -> Tensor:
        """Share of each point that the surface covers, from 0 to 1; arguments as for `distance`."""
        return (EDGE - self.distance(x, y)).clamp(0, 1)


@dataclass(frozen=True)
class Full(Outline):
    """No edge: an endless surface."""

    def distance(self, x: Tensor, y: Tensor) -> Tensor:
        """Signed distance to the edge: -inf, since there is no edge."""
        return x.new_full((len(y), len(x)), -math.inf)


@dataclass(frozen=True)
class Disc(Outline):
    """A circle."""

    lengths = ("radius", "centre")
    radius: AtLeastEdge  # radius in pixels
    centre: tuple[float, float] = (0.0, 0.0)  # (X, Y)

    def distance(self, x: Tensor, y: Tensor) -> Tensor:
        """Distance from the circle."""
        return torch.hypot(x - self.centre[0], y[:, None] - self.centre[1]) - self.radius

    def box(self) -> Box:
        """The box around the circle."""
        return _around([self.centre], self.radius)


@dataclass(frozen=True)
class Polygon(Outline):
    """Straight edges from corner to corner and back; where edges cross, the even-odd rule decides what is inside."""

    lengths = ("corners",)
    corners: tuple[tuple[float, float], ...]  # (X, Y) of three corners at least

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.corners) < 3:
            raise InputError("a polygon needs at least three corners", got=self.corners)

    def distance(self, x: Tensor, y: Tensor) -> Tensor:
        """Distance from the nearest edge; inside is where a ray to the right crosses an odd number of edges."""
        y = y[:, None]
        nearest = x.new_full((len(y), len(x)), math.inf)
        is_inside = torch.zeros(nearest.shape, dtype=torch.bool, device=x.device)
        for (start_x, start_y), (end_x, end_y) in itertools.pairwise((*self.corners, self.corners[0])):
            nearest = torch.minimum(nearest, _squared_distance((start_x, start_y, end_x, end_y), x, y))
            if start_y != end_y:
                # The ray of a row meets the edge's line at this x. Half-open in y: a corner of two edges counts once.
                crossing_x = start_x + (y - start_y) * ((end_x - start_x) / (end_y - start_y))
                is_inside ^= ((y < start_y) != (y < end_y)) & (x < crossing_x)
        return torch.where(is_inside, -nearest.sqrt(), nearest.sqrt())

    def box(self) -> Box:
        """The box around the corners."""
        return _around(self.corners, 0)


@dataclass(frozen=True)
class Leaf(Outline):
    """A pointed leaf: the intersection of two equal circles."""

    lengths = ("length", "width", "centre")
    length: checks.Positive  # distance from tip to tip in pixels
    width: checks.Positive  # width across the middle in pixels, below the length
    angle: float = 0.0  # direction of its axis in degrees, from x towards y
    centre: tuple[float, float] = (0.0, 0.0)  # (X, Y)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.width < self.length:
            raise InputError("a leaf must be longer than wide", got=f"{self.length:g} x {self.width:g}")

    def distance(self, x: Tensor, y: Tensor) -> Tensor:
        """Distance from the nearer arc, or from a tip beyond it."""
        # Both axes are axes of symmetry: one quarter of the leaf stands for all.
        rotated = _rotated(x - self.centre[0], y[:, None] - self.centre[1], self.angle)
        along, across = (offset.abs() for offset in rotated)
        # A chord of length l whose arc rises by w / 2 belongs to the radius (l^2 + w^2) / (4 w). In the quarter where
        # both offsets are positive, the arc's centre lies across the axis, at -(radius - w / 2).
        radius, half = (self.length**2 + self.width**2) / (4 * self.width), self.length / 2
        to_centre = radius - self.width / 2
        # Beyond the normal of the arc at its tip, the tip is the nearest point.
        is_beyond = (along - half) * to_centre > across * half
        from_arc = torch.hypot(along, across + to_centre) - radius
        return torch.where(is_beyond, torch.hypot(along - half, across), from_arc)

    def box(self) -> Box:
        """The box around the tips."""
        return _around([self.centre], self.length / 2)


@dataclass(frozen=True)
class Twigs(Outline):
    """Thin branching lines that grow from one point, drawn by a seed."""

    lengths = ("length", "width", "foot")
    length: checks.Positive  # length of the first branch in pixels; each generation is shorter by a third
    width: Annotated[float, 2 * EDGE, math.inf] = 2.0  # width of all branches in pixels
    generations: Annotated[int, 0, 6] = 4  # number of forks from foot to tip; each branch ends in two
    angle: float = -90.0  # direction of the first branch in degrees, from x towards y
    foot: tuple[float, float] = (0.0, 0.0)  # (X, Y) of the start of the first branch
    seed: checks.Seed = 0  # seed of the directions and lengths of the branches

    def distance(self, x: Tensor, y: Tensor) -> Tensor:
        """Distance from the nearest branch; one pixel where none is near, which is far enough from the edge."""

        def between(values: Tensor, low: float, high: float) -> slice:
            bounds = torch.tensor([low, high], dtype=values.dtype, device=values.device)
            return slice(*torch.searchsorted(values, bounds).tolist())

        result = x.new_full((len(y), len(x)), 2 * EDGE)
        for segment in self.branches():
            # Only the samples around a branch are computed: there are up to 127 branches.
            left, top, right, bottom = _around([segment[:2], segment[2:]], self.width / 2)
            rows, columns = between(y, top, bottom), between(x, left, right)
            near = _squared_distance(segment, x[columns], y[rows, None]).sqrt() - self.width / 2
            result[rows, columns] = torch.minimum(result[rows, columns], near)
        return result

    def box(self) -> Box:
        """The box around all branches."""
        ends = [end for segment in self.branches() for end in (segment[:2], segment[2:])]
        return _around(ends, self.width / 2)

    @functools.lru_cache(maxsize=64)  # noqa: B019  a few small descriptions
    def branches(self) -> tuple[Segment, ...]:
        """All 2^(generations + 1) - 1 branches as straight lines."""
        random = np.random.default_rng(self.seed)

        def grow(x: float, y: float, angle: float, length: float, generations: int) -> Iterator[Segment]:
            length_drawn = length * random.uniform(0.7, 1.0)
            end = (x + length_drawn * math.cos(angle), y + length_drawn * math.sin(angle))
            yield (x, y, *end)
            for side in (-1, 1) if generations > 0 else ():
                turn = side * random.uniform(0.2, 0.7)
                yield from grow(*end, angle + turn, length * 2 / 3, generations - 1)

        return tuple(grow(*self.foot, math.radians(self.angle), self.length, self.generations))


@dataclass(frozen=True)
class Perforated(Outline):
    """An endless surface with round holes on a square lattice."""

    lengths = ("pitch", "radius")
    pitch: float  # distance of neighbouring holes in pixels
    radius: AtLeastEdge  # radius of a hole in pixels, at most half the pitch less half a pixel
    angle: float = 0.0  # direction of the lattice in degrees, from x towards y

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.radius <= self.pitch / 2 - EDGE:
            remedy = "half the pitch must be half a pixel more than the radius"
            raise InputError("holes must leave something between them", got=self, remedy=remedy)

    def distance(self, x: Tensor, y: Tensor) -> Tensor:
        """Distance from the edge of the nearest hole, below 0 outside of it."""
        along, across = _rotated(x, y[:, None], self.angle)
        # Offsets from the centre of the nearest hole, along both axes of the lattice.
        offsets = [offset - self.pitch * (offset / self.pitch).round() for offset in (along, across)]
        return self.radius - torch.hypot(*offsets)


def _around(points: Iterable[tuple[float, float]], radius: float) -> Box:
    """The box around discs about points, with their edges."""
    xs, ys = zip(*points, strict=True)
    margin = radius + EDGE
    return min(xs) - margin, min(ys) - margin, max(xs) + margin, max(ys) + margin


def _rotated(x: Tensor, y: Tensor, angle: float) -> tuple[Tensor, Tensor]:
    """Coordinates along an axis at `angle` degrees, and across it."""
    cosine, sine = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    return cosine * x + sine * y, cosine * y - sine * x


def _squared_distance(segment: Segment, x: Tensor, y: Tensor) -> Tensor:
    """Squared distance of points from the nearest point of a segment: the foot of the perpendicular, or an end."""
    along_x, along_y = segment[2] - segment[0], segment[3] - segment[1]
    offset_x, offset_y = x - segment[0], y - segment[1]
    squared_length = max(along_x**2 + along_y**2, 1e-12)  # a segment may be a point
    share = ((offset_x * along_x + offset_y * along_y) / squared_length).clamp(0, 1)
    return (offset_x - share * along_x) ** 2 + (offset_y - share * along_y) ** 2
