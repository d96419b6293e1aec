"""The compiled look-ups of bitmaps at any points: cubic, as in `lookups`, and linear.

A bitmap's channels lie side by side, in a row of values that may hold other bitmaps too; its ends go on beyond it.
Letters: `i j` column and row in samples, `t` fraction of a sample.
"""

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import inlined

Reals = NDArray[np.floating]
Quadruple = tuple[np.floating, np.floating, np.floating, np.floating]
"""Weights of four samples, or red, green, blue and opacity."""


@inlined
def cubic(samples: Reals, start: int, rows: int, columns: int, i: float, j: float) -> Quadruple:
    """Four channels at a point.

    Args:
        samples: Values, [all].
        start: Place of the bitmap's first.
        rows: Of the bitmap.
        columns: Of the bitmap.
        i: Column.
        j: Row.
    """
    column, row = np.floor(i), np.floor(j)
    across, down = cubic_weights(np.float32(i - column)), cubic_weights(np.float32(j - row))
    first, top = _clamped(column, columns) - 1, _clamped(row, rows) - 1
    c0 = c1 = c2 = c3 = np.float32(0)
    for b in range(4):
        line = start + 4 * columns * min(max(top + b, 0), rows - 1)
        for a in range(4):
            weight = across[a] * down[b]
            place = line + 4 * min(max(first + a, 0), columns - 1)
            c0 += weight * samples[place]
            c1 += weight * samples[place + 1]
            c2 += weight * samples[place + 2]
            c3 += weight * samples[place + 3]
    return c0, c1, c2, c3


@inlined
def linear(samples: Reals, start: int, rows: int, columns: int, i: float, j: float) -> Quadruple:
    """Four channels at a point of a bitmap of two rows and columns at least; arguments as for `cubic`."""
    i, j = min(max(i, 0.0), columns - 1.0), min(max(j, 0.0), rows - 1.0)
    column, row = min(int(i), columns - 2), min(int(j), rows - 2)
    across, down = samples.dtype.type(i - column), samples.dtype.type(j - row)
    one = samples.dtype.type(1)
    w11 = across * down
    w10, w01 = down - w11, across - w11
    w00 = one - across - w10
    a = start + 4 * (row * columns + column)
    b = a + 4 * columns
    return (
        w00 * samples[a] + w01 * samples[a + 4] + w10 * samples[b] + w11 * samples[b + 4],
        w00 * samples[a + 1] + w01 * samples[a + 5] + w10 * samples[b + 1] + w11 * samples[b + 5],
        w00 * samples[a + 2] + w01 * samples[a + 6] + w10 * samples[b + 2] + w11 * samples[b + 6],
        w00 * samples[a + 3] + w01 * samples[a + 7] + w10 * samples[b + 3] + w11 * samples[b + 7],
    )


@inlined
def cubic_weights(t: np.float32) -> Quadruple:
    """Keys' weights, as in `lookups`."""
    half, squared = np.float32(0.5), t * t
    cubed = squared * t
    return (
        squared - half * (t + cubed),
        np.float32(1) - np.float32(2.5) * squared + np.float32(1.5) * cubed,
        half * t + np.float32(2) * squared - np.float32(1.5) * cubed,
        half * (cubed - squared),
    )


@inlined
def _clamped(position: float, length: int) -> int:
    return int(min(max(position, -4.0), length + 4.0))
