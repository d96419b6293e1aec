"""The compiled loop that reads pictures at other rows and columns.

Letters: `b` picture, `y x` row and column made, `t` tap.
"""

import numpy as np

from lfref.functional import jit


@jit.compiled
def resample(pictures, rows, row_weights, columns, column_weights, made, first, last):  # type: ignore[no-untyped-def]
    """Make the pictures from `first` to before `last`.

    Args:
        pictures: Samples, [B, H, W].
        rows: Rows that each made row is of, [B, H, T].
        row_weights: Their weights, [B, H, T].
        columns: Columns that each made column is of, [B, W, T].
        column_weights: Their weights, [B, W, T].
        made: What to fill, [B, H, W].
        first: Number of the first picture.
        last: Number after the last one.
    """
    height, width = made.shape[1:]
    n_taps = rows.shape[2]
    line = np.empty(width, made.dtype)
    for b in range(first, last):
        for y in range(height):
            line[:] = 0
            for t in range(n_taps):
                weight = row_weights[b, y, t]
                if weight != 0:
                    source = pictures[b, rows[b, y, t]]
                    for x in range(width):
                        line[x] += weight * source[x]
            for x in range(width):
                total = line[0] * 0
                for t in range(n_taps):
                    total += column_weights[b, x, t] * line[columns[b, x, t]]
                made[b, y, x] = total
