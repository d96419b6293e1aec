"""The loop, compiled by Numba, that adds up spectra of views times their factors.

`LANES` frequencies of a row go through every step together, so that each step is one machine instruction for many.
Letters: `n` plane, `p` sum or difference of opposite views, `j` picture (light field, channel and square), `y x`
row and column of frequencies.
"""

import numpy as np
from numpy.typing import NDArray

from lfref.functional import jit

LANES = 16


@jit.compiled
def add_rows(
    spectra: NDArray, factors: NDArray, n_sums: int, first: int, last: int, made: NDArray
) -> None:  # pragma: no cover - compiled
    """Add up rows of frequencies from `first` to before `last`.

    Args:
        spectra: Pairs of real and imaginary part, [p, j, y, x, 2].
        factors: In whole lanes, [n, y, x lanes, p, LANES].
        n_sums: The first p that are sums; the factors of the others are times i.
        first: Row.
        last: One past the last row.
        made: Written to, [n, j, y, x, 2].
    """
    n_given, n_pictures, _, width, _ = spectra.shape
    real = np.zeros((n_pictures, n_given, LANES), spectra.dtype)
    imaginary = np.zeros((n_pictures, n_given, LANES), spectra.dtype)
    both = np.zeros((2, LANES), spectra.dtype)
    for y in range(first, last):
        for x in range(0, width, LANES):
            lanes = min(LANES, width - x)
            for p in range(n_given):
                for j in range(n_pictures):
                    for lane in range(lanes):
                        real[j, p, lane] = spectra[p, j, y, x + lane, 0]
                        imaginary[j, p, lane] = spectra[p, j, y, x + lane, 1]
            for n in range(factors.shape[0]):
                weights = factors[n, y, x // LANES]
                for j in range(n_pictures):
                    both[:] = 0
                    _add(real[j, :n_sums], weights[:n_sums], 1, both[0])
                    _add(imaginary[j, :n_sums], weights[:n_sums], 1, both[1])
                    _add(imaginary[j, n_sums:], weights[n_sums:], -1, both[0])
                    _add(real[j, n_sums:], weights[n_sums:], 1, both[1])
                    for lane in range(lanes):
                        made[n, j, y, x + lane, 0] = both[0, lane]
                        made[n, j, y, x + lane, 1] = both[1, lane]


@jit.compiled
def _add(values: NDArray, weights: NDArray, sign: int, total: NDArray) -> None:  # pragma: no cover - compiled
    """Add sign times the weighted sum of values [p, LANES] to a total [LANES], four at a time."""
    last = len(values) - len(values) % 4
    for p in range(0, last, 4):
        for lane in range(LANES):
            near = weights[p, lane] * values[p, lane] + weights[p + 1, lane] * values[p + 1, lane]
            far = weights[p + 2, lane] * values[p + 2, lane] + weights[p + 3, lane] * values[p + 3, lane]
            total[lane] += sign * (near + far)
    for p in range(last, len(values)):
        for lane in range(LANES):
            total[lane] += sign * weights[p, lane] * values[p, lane]
