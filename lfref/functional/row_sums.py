"""Compiled weighted sums of eight stretches of a row in one pass: the inner loop of shift-and-sum and of blurs.

A stretch is `total.size` samples of `rows` from a start on, so that a filter along the row, or along a column of rows
that lie one after the other, is a table of starts and weights. The sums are written out because Numba vectorises plain
sums of eight products, but not a loop over them.
"""

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import LANES, compiled

TAPS = 8
"""Taps that one pass over a row adds up: more would leave no registers for their weights."""

Integers = NDArray[np.int64]
Reals = NDArray[np.floating]


def rounded_up(width: int) -> int:
    """A width rounded up to whole vectors, so that no loop ends in single steps."""
    return width + -width % LANES


@compiled
def set_taps(rows: Reals, starts: Integers, weights: Reals, total: Reals) -> None:
    """The weighted sum of `TAPS` stretches of `rows`, in one pass."""
    r0, r1, r2, r3 = rows[starts[0] :], rows[starts[1] :], rows[starts[2] :], rows[starts[3] :]
    r4, r5, r6, r7 = rows[starts[4] :], rows[starts[5] :], rows[starts[6] :], rows[starts[7] :]
    w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
    w4, w5, w6, w7 = weights[4], weights[5], weights[6], weights[7]
    for x in range(total.size):
        low = w0 * r0[x] + w1 * r1[x] + w2 * r2[x] + w3 * r3[x]
        total[x] = low + w4 * r4[x] + w5 * r5[x] + w6 * r6[x] + w7 * r7[x]


@compiled
def add_taps(rows: Reals, starts: Integers, weights: Reals, total: Reals) -> None:
    """The weighted sum of `TAPS` stretches of `rows`, added to `total`."""
    r0, r1, r2, r3 = rows[starts[0] :], rows[starts[1] :], rows[starts[2] :], rows[starts[3] :]
    r4, r5, r6, r7 = rows[starts[4] :], rows[starts[5] :], rows[starts[6] :], rows[starts[7] :]
    w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
    w4, w5, w6, w7 = weights[4], weights[5], weights[6], weights[7]
    for x in range(total.size):
        low = w0 * r0[x] + w1 * r1[x] + w2 * r2[x] + w3 * r3[x]
        total[x] += low + w4 * r4[x] + w5 * r5[x] + w6 * r6[x] + w7 * r7[x]
