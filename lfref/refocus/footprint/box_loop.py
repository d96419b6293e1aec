"""The compiled loops that blur a plane by a box: along each row as it is read, then down a ring of such rows.

Letters: `y x` row and column, `k` tap, `g` group of `TAPS` taps.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import compiled, inlined
from lfref.functional.row_sums import TAPS, add_taps, set_taps

Integers = NDArray[np.int64]
Reals = NDArray[np.floating]


class Box(NamedTuple):
    """Taps of one width."""

    radius: int
    """Samples to each side that are read."""
    weights: Reals
    """Along a row as down a column; the last group filled up by 0, [G, TAPS]."""


class Scratch(NamedTuple):
    """What one thread works in."""

    line: Reals
    """A row, continued beyond both ends."""
    ring: Reals
    """Rows blurred along themselves, used in turn, one after the other."""
    total: Reals
    """A blurred row, [W rounded up]."""
    starts: Integers
    """Where taps read, [G, TAPS]."""


class Around(NamedTuple):
    """What stands beyond the edges of a plane."""

    head: Reals
    """Rows above it, `radius` of them, [radius, W]."""
    tail: Reals
    """Rows below it, likewise."""
    columns: Integers
    """Column of each place from -radius to W + radius; -1: black, [W + 2 radius]."""


@compiled
def blur(image: Reals, around: Around, box: Box, factors: Reals, kinds: Integers, work: Scratch) -> None:
    """Blur a plane where it lies.

    Args:
        image: [H, W].
        around: What it is continued by.
        box: The taps.
        factors: What a blurred row is multiplied by, [kinds, W].
        kinds: Which of them, for each row, [H].
        work: To work in; what lies beyond its rows' ends is finite.
    """
    for y in range(-box.radius, image.shape[0] + box.radius):
        _blur_along(y, image, around, box, work)
        r = y - box.radius
        if r >= 0:
            _blur_down(r, box, work)
            result, row_factors = image[r], factors[kinds[r]]
            for x in range(result.size):
                result[x] = work.total[x] * row_factors[x]


@compiled
def add_level(
    image: Reals, around: Around, box: Box, places: Reals, level: float, unit: float, total: Reals, work: Scratch
) -> None:
    """Blur a plane by the box of a level, and add its share to the pixels that blend it.

    Args:
        image: [H, W].
        around: What it is continued by.
        box: The taps.
        places: Of the pixels' widths among the levels, [H, W].
        level: In the type of the image, as `unit`: whole numbers would make the loop compute in float64.
        unit: 1.
        total: Added to, [H, W].
        work: As of `blur`.
    """
    for y in range(-box.radius, image.shape[0] + box.radius):
        _blur_along(y, image, around, box, work)
        r = y - box.radius
        if r >= 0:
            result, row = total[r], places[r]
            if _is_blended(row, level, unit):
                _blur_down(r, box, work)
                for x in range(result.size):
                    result[x] += max(unit - abs(row[x] - level), unit - unit) * work.total[x]


@inlined
def _is_blended(places: Reals, level: float, unit: float) -> bool:
    """Whether any pixel of a row has a share of a level."""
    count = 0
    for x in range(places.size):
        count += abs(places[x] - level) < unit
    return count > 0


@inlined
def _blur_along(y: int, image: Reals, around: Around, box: Box, work: Scratch) -> None:
    """Blur a row along itself, into the ring."""
    height, n_rows, length = image.shape[0], 2 * box.radius + 1, work.total.size
    row = around.head[y + box.radius] if y < 0 else (image[y] if y < height else around.tail[y - height])
    _extend(row, around.columns, box.radius, work.line)
    for k in range(work.starts.size):
        work.starts[k // TAPS, k % TAPS] = k if k < n_rows else 0
    place = (y + box.radius) % n_rows
    _sum(work.line, work.starts, box.weights, work.ring[place * length : (place + 1) * length])


@inlined
def _blur_down(r: int, box: Box, work: Scratch) -> None:
    """Blur the rows around row r, all of them in the ring, down the columns."""
    n_rows, length = 2 * box.radius + 1, work.total.size
    for k in range(work.starts.size):
        work.starts[k // TAPS, k % TAPS] = ((r + (k if k < n_rows else 0)) % n_rows) * length
    _sum(work.ring, work.starts, box.weights, work.total)


@inlined
def _extend(row: Reals, columns: Integers, radius: int, line: Reals) -> None:
    width = row.size
    inner = line[radius : radius + width]
    for x in range(width):
        inner[x] = row[x]
    for x in range(radius):
        left, right = columns[x], columns[radius + width + x]
        line[x] = row[left] if left >= 0 else 0
        line[radius + width + x] = row[right] if right >= 0 else 0


@inlined
def _sum(rows: Reals, starts: Integers, weights: Reals, total: Reals) -> None:
    set_taps(rows, starts[0], weights[0], total)
    for g in range(1, weights.shape[0]):
        add_taps(rows, starts[g], weights[g], total)
