"""Compiled: samples that stick out of the eight about them, in one pass over a picture.

Letters: `y x` pixel row and column.
"""

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import compiled


@compiled
def spread(planes: NDArray, step: int) -> tuple[float, int]:
    """Sum and number of what samples stick out by, over every so many rows of pictures [B, H, W]."""
    width = planes.shape[2]
    excess = np.empty(width, planes.dtype)
    total, count = 0.0, 0
    for plane in planes:
        for y in range(1, plane.shape[0] - 1, step):
            _excess(plane[y - 1], plane[y], plane[y + 1], excess)
            for x in range(1, width - 1):
                if excess[x] > 0:
                    total += excess[x]
                    count += 1
    return total, count


@compiled
def sticking_out(planes: NDArray, limit: float, found: NDArray, heights: NDArray) -> int:
    """Places [K, 3] of samples that stick out by more than a limit, and by how much; how many, at most K."""
    width = planes.shape[2]
    excess = np.empty(width, planes.dtype)
    count = 0
    for n in range(planes.shape[0]):
        plane = planes[n]
        for y in range(1, plane.shape[0] - 1):
            _excess(plane[y - 1], plane[y], plane[y + 1], excess)
            most = excess[1]
            for x in range(1, width - 1):
                most = max(most, excess[x])
            if most <= limit:
                continue
            for x in range(1, width - 1):
                if excess[x] > limit and count < len(found):
                    found[count, 0], found[count, 1], found[count, 2], heights[count] = n, y, x, excess[x]
                    count += 1
    return count


@compiled
def _excess(above: NDArray, row: NDArray, below: NDArray, excess: NDArray) -> None:
    """How far each sample of a row is above or below all about it; less than 0: it is among them."""
    for x in range(1, row.size - 1):
        high = max(max(above[x - 1], above[x]), max(above[x + 1], row[x - 1]))
        high = max(high, max(max(below[x - 1], below[x]), max(below[x + 1], row[x + 1])))
        low = min(min(above[x - 1], above[x]), min(above[x + 1], row[x - 1]))
        low = min(low, min(min(below[x - 1], below[x]), min(below[x + 1], row[x + 1])))
        excess[x] = max(row[x] - high, low - row[x])
