"""The compiled loop of `paths`: the cheapest way to each pixel along lines of one direction.

Letters: `n` label, `y x` pixel row and column.
"""

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import compiled, inlined

Reals = NDArray[np.float32]


@compiled
def add_paths(costs: Reals, jumps: Reals, change: float, down: int, right: int, total: Reals) -> None:
    """Add what the cheapest way along a direction costs that ends at each pixel with each label.

    Args:
        costs: Of each label, [H, W, N].
        jumps: What a change by more than one label costs between a pixel and the one before it, [H, W].
        change: What a change by one label costs.
        down: Step of the direction along y: -1, 0 or 1.
        right: Step along x; along y it must be 0 or else the first.
        total: Added to, [H, W, N].
    """
    height, width, n_labels = costs.shape
    before, here = np.zeros((width, n_labels), np.float32), np.zeros((width, n_labels), np.float32)
    for i in range(height):
        y = i if down >= 0 else height - 1 - i
        for j in range(width):
            x = j if right >= 0 else width - 1 - j
            previous = x - right
            if 0 <= previous < width and (down == 0 or i > 0):
                way = here[previous] if down == 0 else before[previous]
                _go_on(costs[y, x], way, np.float32(change), jumps[y, x], here[x])
            else:
                here[x] = costs[y, x]
            for n in range(n_labels):
                total[y, x, n] += here[x, n]
        if down != 0:
            before, here = here, before


@inlined
def _go_on(costs: Reals, way: Reals, change: float, jump: float, here: Reals) -> None:
    """The way one pixel on: stay, change by one label, or jump; less the least before, so that numbers stay small."""
    n_labels, least = costs.size, way.min()
    farther = least + jump
    for n in range(n_labels):
        here[n] = min(way[n], farther)
    for n in range(1, n_labels):
        here[n] = min(here[n], way[n - 1] + change)
    for n in range(n_labels - 1):
        here[n] = min(here[n], way[n + 1] + change)
    for n in range(n_labels):
        here[n] += costs[n] - least
