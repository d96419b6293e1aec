"""Compiled: samples that stick out of the eight about them, in one pass over pictures.

Letters: `y x` pixel row and column.
"""

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import compiled, inlined


@compiled
def spread(views: NDArray, channel: int, step: int) -> tuple[float, int]:
    """Sum and number of what samples of a channel stick out by, over every so many rows of pictures [B, C, H, W]."""
    scratch = np.empty((3, views.shape[3]), views.dtype)
    excess = scratch[2]
    total, count = 0.0, 0
    for n in range(views.shape[0]):
        plane = views[n, channel]
        for y in range(1, plane.shape[0] - 1, step):
            _excess(plane[y - 1], plane[y], plane[y + 1], scratch)
            for x in range(1, excess.size - 1):
                if excess[x] > 0:
                    total += excess[x]
                    count += 1
    return total, count


@compiled
def sticking_out(views: NDArray, channel: int, limit: float, found: NDArray, heights: NDArray) -> int:
    """Write picture, row, column [K, 3] of samples beyond a limit, and how far they stick out; how many, at most K."""
    scratch = np.empty((3, views.shape[3]), views.dtype)
    excess = scratch[2]
    least, count = views.dtype.type(limit), 0
    for n in range(views.shape[0]):
        plane = views[n, channel]
        for y in range(1, plane.shape[0] - 1):
            _excess(plane[y - 1], plane[y], plane[y + 1], scratch)
            n_out = 0
            for x in range(1, excess.size - 1):
                n_out += excess[x] > least
            if n_out == 0:
                continue
            for x in range(1, excess.size - 1):
                if excess[x] > least and count < len(found):
                    found[count, 0], found[count, 1], found[count, 2], heights[count] = n, y, x, excess[x]
                    count += 1
    return count


@inlined
def _larger(a: float, b: float) -> float:
    # The built-in one looks for NaN, and then does not run on vectors.
    return a if a > b else b


@inlined
def _smaller(a: float, b: float) -> float:
    return a if a < b else b


@compiled
def _excess(above: NDArray, row: NDArray, below: NDArray, scratch: NDArray) -> None:
    """How far each sample of a row is above or below all about it, scratch[2]; less than 0: it is among them."""
    high, low, excess = scratch[0], scratch[1], scratch[2]
    for x in range(row.size):
        high[x] = _larger(_larger(above[x], below[x]), row[x])
        low[x] = _smaller(_smaller(above[x], below[x]), row[x])
    for x in range(1, row.size - 1):
        most = _larger(_larger(high[x - 1], high[x + 1]), _larger(above[x], below[x]))
        least = _smaller(_smaller(low[x - 1], low[x + 1]), _smaller(above[x], below[x]))
        excess[x] = _larger(row[x] - most, least - row[x])
