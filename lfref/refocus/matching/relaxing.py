"""A smooth map from values that are known unequally well: flat regions take what their edges know.

The energy is the sum of trust (value - target)^2 over pixels, and of tie (value - neighbour's)^2 over neighbours. It is
minimised line by line, all rows at once and then all columns.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.refocus.matching import lines_loop

ROUNDS = 16
"""Times that rows and columns are solved: what is known spreads farther in each."""
LEAST_TRUST = 1e-9
"""Of the ties: where neither neighbours nor pixels know anything, values stay."""


def relaxed(target: Tensor, trust: Tensor, across: Tensor, down: Tensor) -> Tensor:
    """The smooth map, float64.

    Args:
        target: What values should be, [H, W].
        trust: Of the targets, >= 0, [H, W].
        across: What ties each value to the one to its right, >= 0, the last column unused, [H, W].
        down: What ties it to the one below, the last row unused, [H, W].
    """
    aims, ties, falls = (np.ascontiguousarray(map_.double().numpy()) for map_ in (target, across, down))
    sure = trust.double().numpy() + LEAST_TRUST
    rows, columns = (sure, aims, ties, falls), tuple(np.ascontiguousarray(part.T) for part in (sure, aims, falls, ties))
    values = aims
    for _ in range(ROUNDS):
        values = _solved(values, *rows)
        values = np.ascontiguousarray(_solved(np.ascontiguousarray(values.T), *columns).T)
    return torch.from_numpy(values)


def _solved(
    values: NDArray[np.float64],
    trust: NDArray[np.float64],
    target: NDArray[np.float64],
    across: NDArray[np.float64],
    down: NDArray[np.float64],
) -> NDArray[np.float64]:
    solved = np.empty_like(values)
    lines_loop.solve_rows(values, trust, target, across, down, solved)
    return solved
