"""The compiled loop that reads pictures at other rows and columns.

Letters: `b` picture, `y x` row and column made, `t` tap, `P` columns by which pictures go on beyond either edge.
"""

import numpy as np

from lfref.functional import jit


@jit.compiled
def resample(pictures, rows, row_weights, starts, column_weights, made, first, last):  # type: ignore[no-untyped-def]
    """Make the pictures from `first` to before `last`.

    Args:
        pictures: Samples, [B, H, W].
        rows: Rows that each made row is of, [B, H, T].
        row_weights: Their weights, [B, H, T].
        starts: First of the columns side by side that each made column is of, from -T + 1 to W - 1, [B, W].
        column_weights: Their weights, [B, T, W].
        made: What to fill, [B, H, W].
        first: Number of the first picture.
        last: Number after the last one.
    """
    height, width = made.shape[1:]
    n_taps = rows.shape[2]
    beyond = n_taps
    line = np.empty(width + 2 * beyond, made.dtype)
    middle = line[beyond : beyond + width]
    for b in range(first, last):
        for y in range(height):
            line[:] = 0
            for t in range(n_taps):
                weight = row_weights[b, y, t]
                if weight != 0:
                    source = pictures[b, rows[b, y, t]]
                    for x in range(width):
                        middle[x] += weight * source[x]
            line[:beyond] = line[beyond]
            line[beyond + width :] = line[beyond + width - 1]
            into = made[b, y]
            into[:] = 0
            begin = 0
            while begin < width:
                # Columns whose samples lie side by side are made together.
                start = starts[b, begin] - begin
                end = begin + 1
                while end < width and starts[b, end] - end == start:
                    end += 1
                run = into[begin:end]
                for t in range(n_taps):
                    # Slices begin at 0: an index that might be negative would keep the loop from going in steps.
                    weights, first_read = column_weights[b, t, begin:end], beyond + start + t + begin
                    source = line[first_read : first_read + len(run)]
                    for x in range(len(run)):
                        run[x] += weights[x] * source[x]
                begin = end
