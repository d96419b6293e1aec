"""The compiled loop of `relaxing`: all rows of a map solved at once, each with its neighbours where they were.

Letters: `y x` pixel row and column.
"""

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import compiled

Reals = NDArray[np.float64]


@compiled
def solve_rows(values: Reals, trust: Reals, target: Reals, across: Reals, down: Reals, solved: Reals) -> None:
    """The map whose rows each minimise the energy of `relaxing` while the other rows stay.

    Args:
        values: The map so far, [H, W].
        trust: Of the targets, >= 0, [H, W].
        target: What values should be, [H, W].
        across: What ties each value to the one to its right, >= 0, the last column unused, [H, W].
        down: What ties it to the one below, the last row unused, [H, W].
        solved: Filled, [H, W].
    """
    height, width = values.shape
    share, rest = np.empty(width), np.empty(width)
    for y in range(height):
        for x in range(width):
            diagonal, side = trust[y, x], trust[y, x] * target[y, x]
            if y > 0:
                diagonal += down[y - 1, x]
                side += down[y - 1, x] * values[y - 1, x]
            if y < height - 1:
                diagonal += down[y, x]
                side += down[y, x] * values[y + 1, x]
            if x > 0:
                diagonal += across[y, x - 1] * (1 - share[x - 1])
                side += across[y, x - 1] * rest[x - 1]
            tie = across[y, x] if x < width - 1 else 0.0
            share[x], rest[x] = tie / (diagonal + tie), side / (diagonal + tie)
        solved[y, width - 1] = rest[width - 1]
        for x in range(width - 2, -1, -1):
            solved[y, x] = rest[x] + share[x] * solved[y, x + 1]
