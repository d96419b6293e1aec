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


@compiled
def blur(
    image: Reals, head: Reals, tail: Reals, columns: Integers, box: Box, factors: Reals, kinds: Integers, work: Scratch
) -> None:
    """Blur a plane where it lies.

    Args:
        image: [H, W].
        head: Rows above it, `radius` of them, [radius, W].
        tail: Rows below it, likewise.
        columns: Column of each place from -radius to W + radius; -1: black, [W + 2 radius].
        box: The taps.
        factors: What a blurred row is multiplied by, [kinds, W].
        kinds: Which of them, for each row, [H].
        work: To work in; what lies beyond its rows' ends is finite.
    """
    height, n_rows, length = image.shape[0], 2 * box.radius + 1, work.total.size
    for y in range(-box.radius, height + box.radius):
        row = head[y + box.radius] if y < 0 else (image[y] if y < height else tail[y - height])
        _extend(row, columns, box.radius, work.line)
        for k in range(work.starts.size):
            work.starts[k // TAPS, k % TAPS] = k if k < n_rows else 0
        place = (y + box.radius) % n_rows
        _sum(work.line, work.starts, box.weights, work.ring[place * length : (place + 1) * length])
        r = y - box.radius
        if r >= 0:
            for k in range(work.starts.size):
                work.starts[k // TAPS, k % TAPS] = ((r + (k if k < n_rows else 0)) % n_rows) * length
            _sum(work.ring, work.starts, box.weights, work.total)
            _finish(work.total, factors[kinds[r]], image[r])


@compiled
def add_level(blurred: Reals, places: Reals, level: int, total: Reals) -> None:
    """Add the share of one level to the pixels that blend it, [H, W] each."""
    for y in range(total.shape[0]):
        for x in range(total.shape[1]):
            total[y, x] += max(1 - abs(places[y, x] - level), 0) * blurred[y, x]


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


@inlined
def _finish(total: Reals, factors: Reals, result: Reals) -> None:
    for x in range(result.size):
        result[x] = total[x] * factors[x]
