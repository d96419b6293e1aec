"""The compiled loop of box blurs: running sums over rows, then along them."""

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import compiled

Reals = NDArray[np.floating]


@compiled
def box_mean(samples: Reals, size: int, result: Reals) -> None:
    """Means over `size` x `size` samples, the ends going on beyond them.

    Args:
        samples: [h, w, C].
        size: Odd.
        result: Filled, [h + size - 1, w + size - 1, C].
    """
    height = samples.shape[0]
    sums = samples[0].astype(np.float64) * size
    for row in range(result.shape[0]):
        added, dropped = samples[min(row, height - 1)], samples[max(row - size, 0)]
        _replace(sums, added, dropped)
        _means_along(sums, size, result[row])


@compiled
def _replace(sums: Reals, added: Reals, dropped: Reals) -> None:
    for x in range(sums.shape[0]):
        for c in range(sums.shape[1]):
            sums[x, c] += added[x, c] - dropped[x, c]


@compiled
def _means_along(sums: Reals, size: int, row: Reals) -> None:
    width, share = sums.shape[0], 1.0 / (size * size)
    for c in range(sums.shape[1]):
        total = sums[0, c] * size
        for x in range(row.shape[0]):
            total += sums[min(x, width - 1), c] - sums[max(x - size, 0), c]
            row[x, c] = total * share
