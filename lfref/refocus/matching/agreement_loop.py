"""The compiled loop of `agreement`: one slope, one band of rows, the views shifted and compared a row at a time.

Letters: `k` view, `y x` pixel row and column, `r` what views are compared with.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import compiled, inlined

Reals = NDArray[np.float32]
Integers = NDArray[np.int64]


class Shifts(NamedTuple):
    """How each view is read at one slope: cubic taps along both axes, and where it has samples."""

    rows: Integers
    """First row that is read for y = 0, [K]."""
    row_weights: Reals
    """[K, 4]."""
    row_spans: Integers
    """First row served, and one past the last, [K, 2]."""
    columns: Integers
    """As `rows`, [K]."""
    column_weights: Reals
    """[K, 4]."""
    column_spans: Integers
    """[K, 2]."""


@compiled
def disagree(samples: Reals, middle: Integers, shifts: Shifts, spread: Reals, rows: Integers, shares: Reals) -> None:
    """The share of views, softly counted, that show something else than most of them do.

    Args:
        samples: Grey views, [K, H, W].
        middle: Those to compare with at first.
        shifts: How they are read.
        spread: Square of the difference that counts as half a disagreement, [H, W].
        rows: Rows to look at, [R].
        shares: Filled, in [0, 1], [R, W].
    """
    n_views, _, width = samples.shape
    moved, line = np.empty((n_views, width), np.float32), np.empty(width + 4, np.float32)
    reference, weights, total = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    for i in range(rows.size):
        y = rows[i]
        served = np.flatnonzero((shifts.row_spans[:, 0] <= y) & (y < shifts.row_spans[:, 1]))
        for k in served:
            _move(samples[k], shifts, k, y, line, moved[k])
        _average(moved, middle, served, shifts, reference, weights)
        _agree(moved, served, shifts, spread[y], reference, weights, total)
        _compare(moved, served, shifts, spread[y], reference, weights, shares[i])


@inlined
def _move(view: Reals, shifts: Shifts, k: int, y: int, line: Reals, moved: Reals) -> None:
    """Row y of a shifted view, where it has samples."""
    height, width = view.shape
    top, (a, b, c, d) = y + shifts.rows[k], shifts.row_weights[k]
    first, second = view[min(max(top, 0), height - 1)], view[min(max(top + 1, 0), height - 1)]
    third, fourth = view[min(max(top + 2, 0), height - 1)], view[min(max(top + 3, 0), height - 1)]
    inner = line[2 : 2 + width]
    for x in range(width):
        inner[x] = a * first[x] + b * second[x] + c * third[x] + d * fourth[x]
    line[:2], line[2 + width :] = inner[0], inner[width - 1]
    begin, end = shifts.column_spans[k]
    read, made = line[begin + 2 + shifts.columns[k] :], moved[begin:end]
    a, b, c, d = shifts.column_weights[k]
    for x in range(made.size):
        made[x] = a * read[x] + b * read[x + 1] + c * read[x + 2] + d * read[x + 3]


@inlined
def _average(moved: Reals, middle: Integers, served: Integers, shifts: Shifts, reference: Reals, counts: Reals) -> None:
    """The mean of those views in the middle that have a sample; 0 where none has."""
    reference[:] = 0
    counts[:] = 0
    for k in served:
        if (middle == k).any():
            begin, end = shifts.column_spans[k]
            view, mean, count = moved[k, begin:end], reference[begin:end], counts[begin:end]
            for x in range(view.size):
                mean[x] += view[x]
                count[x] += np.float32(1)
    for x in range(reference.size):
        reference[x] /= max(counts[x], np.float32(1))


@inlined
def _agree(
    moved: Reals, served: Integers, shifts: Shifts, spread: Reals, reference: Reals, weights: Reals, total: Reals
) -> None:
    """Replace the reference by the mean of the views that agree with it: less noise, and no view is special."""
    weights[:] = 0
    total[:] = 0
    for k in served:
        begin, end = shifts.column_spans[k]
        _add_agreement(
            moved[k, begin:end], spread[begin:end], reference[begin:end], weights[begin:end], total[begin:end]
        )
    for x in range(reference.size):
        if weights[x] > 0:
            reference[x] = total[x] / weights[x]


@compiled
def _add_agreement(view: Reals, spread: Reals, reference: Reals, weights: Reals, total: Reals) -> None:
    for x in range(view.size):
        off = view[x] - reference[x]
        weight = spread[x] / (off * off + spread[x])
        weights[x] += weight
        total[x] += weight * view[x]


@inlined
def _compare(
    moved: Reals, served: Integers, shifts: Shifts, spread: Reals, reference: Reals, counts: Reals, shares: Reals
) -> None:
    """Count those that differ, of all that have a sample; nothing agrees where none has."""
    counts[:] = 0
    shares[:] = 0
    for k in served:
        begin, end = shifts.column_spans[k]
        _add_difference(
            moved[k, begin:end], spread[begin:end], reference[begin:end], counts[begin:end], shares[begin:end]
        )
    for x in range(shares.size):
        shares[x] = shares[x] / counts[x] if counts[x] > 0 else np.float32(1)


@compiled
def _add_difference(view: Reals, spread: Reals, reference: Reals, counts: Reals, shares: Reals) -> None:
    for x in range(view.size):
        off = view[x] - reference[x]
        square = off * off
        shares[x] += square / (square + spread[x])
        counts[x] += np.float32(1)
