"""The compiled loop that reads small patches of views between their samples.

Letters: `k` patch, `i` view, `c` channel, `y x` pixel row and column, `t` tap.
"""

import numpy as np

from lfref.functional import jit


@jit.compiled
def read(views, channels, rows, columns, row_weights, column_weights, patches, first, last):  # type: ignore[no-untyped-def]
    """Fill the patches from `first` to before `last`.

    Args:
        views: Samples, [I, all channels, H, W].
        channels: Which of their channels are read, [C].
        rows: First row that a patch takes of a view, [K, I].
        columns: Likewise, [K, I].
        row_weights: Weights of rows side by side, [K, I, T].
        column_weights: Likewise, [K, I, T].
        patches: What to fill, float32, [K, I, C, h, w].
        first: Number of the first patch.
        last: Number after the last patch.
    """
    n_views, n_channels, height, width = patches.shape[1:]
    taps = row_weights.shape[2]
    line = np.empty(width + taps - 1, np.float32)
    for k in range(first, last):
        for i in range(n_views):
            top, left = rows[k, i], columns[k, i]
            down, across = row_weights[k, i], column_weights[k, i]
            for c in range(n_channels):
                view = views[i, channels[c]]
                for y in range(height):
                    line[:] = 0
                    for t in range(taps):
                        # Slices begin at 0: an index that might be negative would keep the loop from going in steps.
                        weight, source = down[t], view[top + y + t, left : left + len(line)]
                        for x in range(len(line)):
                            line[x] += weight * source[x]
                    made = patches[k, i, c, y]
                    made[:] = 0
                    for t in range(taps):
                        weight, source = across[t], line[t : t + width]
                        for x in range(width):
                            made[x] += weight * source[x]
