"""The compiled loop that reads each view wherever a pixel of the picture asks for it, and takes the mean.

Letters: `v u` view row and column, `c` channel, `y x` row and column of the picture, `j i` of a view, `t` fraction of
a pixel, `k m` tap along a column and a row.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref.functional import cubic
from lfref.functional.jit import compiled, inlined
from lfref.refocus.borders import BLACK, LEFT_OUT, ON_VIEW, PERIODIC
from lfref.refocus.interpolations import FARTHEST, LINEAR, NEAREST

MOST_TAPS = 4

Reals = NDArray[np.floating]
_cubic_weights = inlined(cubic.weights)


class Rule(NamedTuple):
    """How views are read."""

    interpolation: int
    """Number of one of `INTERPOLATIONS`."""
    beyond: int
    """Number of one of `BORDERS`."""
    scale: float
    """Of their samples: 1 over the integer that is radiance 1."""


class Table(NamedTuple):
    """Where each view shows what is at a pixel (x, y): at matrix (x, y, 1), moved by slope times offset."""

    matrices: Reals
    """Homogeneous, float64, [V, U, 3, 3]."""
    slopes: Reals
    """At each pixel, in pixels per view step, float64, [H, W]."""
    offsets: Reals
    """(v, u) of each view from the middle, in view steps, float64, [V, U, 2]."""


@compiled
def mean(
    field: NDArray, weights: Reals, table: Table, rule: Rule, image: Reals, coverage: Reals, top: int, end: int
) -> None:
    """The mean of the views that have a sample, in the rows from `top` to before `end`.

    Args:
        field: Views, [V, U, C, H, W].
        weights: Of each view, of sum 1; those of weight 0 are not read, [V, U].
        table: Where they are read.
        rule: How they are read.
        image: Filled in these rows, 0 where no view has a sample, [C, H, W].
        coverage: Filled in these rows: weight of the views that have a sample, float64, [H, W].
        top: First row.
        end: One past the last row.
    """
    n_channels, width = image.shape[0], image.shape[2]
    total, covered = np.empty((n_channels, width)), np.empty(width)
    down, across = np.empty(MOST_TAPS), np.empty(MOST_TAPS)
    rows, columns = np.empty(MOST_TAPS, np.int64), np.empty(MOST_TAPS, np.int64)
    for y in range(top, end):
        total[:], covered[:] = 0, 0
        for v in range(field.shape[0]):
            for u in range(field.shape[1]):
                if weights[v, u] > 0:
                    _add_row(
                        field[v, u], weights[v, u], table, v, u, y, rule, total, covered, down, across, rows, columns
                    )
        for x in range(width):
            coverage[y, x] = covered[x]
            share = rule.scale / covered[x] if covered[x] > 0 else 0.0
            for c in range(n_channels):
                image[c, y, x] = share * total[c, x]


@compiled
def _add_row(
    view: NDArray,
    weight: float,
    table: Table,
    v: int,
    u: int,
    y: int,
    rule: Rule,
    total: Reals,
    covered: Reals,
    down: Reals,
    across: Reals,
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
) -> None:
    """Add a view to a row of the picture; the last four are room for taps."""
    n_channels, height, width = view.shape
    matrix, down_by, across_by = table.matrices[v, u], table.offsets[v, u, 0], table.offsets[v, u, 1]
    for x in range(covered.size):
        w = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
        if not w > 0:  # behind the camera
            continue
        slope = table.slopes[y, x]
        at_x = matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]
        at_y = matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]
        if w != 1:  # divisions take longer than all else
            at_x, at_y = at_x / w, at_y / w
        at_x, at_y = at_x + slope * across_by, at_y + slope * down_by
        at_x, at_y = _snapped(at_x, rule.interpolation), _snapped(at_y, rule.interpolation)
        if not (_counts(at_x, width, rule.beyond) and _counts(at_y, height, rule.beyond)):
            continue
        covered[x] += weight
        i, j = int(np.floor(at_x)), int(np.floor(at_y))
        if rule.interpolation == LINEAR and 0 <= i < width - 1 and 0 <= j < height - 1 and i < at_x and j < at_y:
            # Between four samples that all count.
            t_x, t_y = at_x - i, at_y - j
            for c in range(n_channels):
                upper = (1 - t_x) * view[c, j, i] + t_x * view[c, j, i + 1]
                lower = (1 - t_x) * view[c, j + 1, i] + t_x * view[c, j + 1, i + 1]
                total[c, x] += weight * ((1 - t_y) * upper + t_y * lower)
            continue
        n_taps = _set_taps(at_x, width, rule, columns, across)
        _set_taps(at_y, height, rule, rows, down)
        for c in range(n_channels):
            for k in range(n_taps):
                for m in range(n_taps):
                    share = down[k] * across[m]
                    # What does not count is not read: 0 times NaN is NaN.
                    if share != 0:
                        total[c, x] += weight * share * view[c, rows[k], columns[m]]


@inlined
def _snapped(position: float, interpolation: int) -> float:
    """The position that is really read; what is no number is read far away."""
    if not position >= -FARTHEST:
        return -FARTHEST
    position = min(position, FARTHEST)
    return np.floor(position + 0.5) if interpolation == NEAREST else position


@inlined
def _counts(position: float, length: int, beyond: int) -> bool:
    return beyond != LEFT_OUT or -ON_VIEW <= position <= length - 1 + ON_VIEW


@inlined
def _set_taps(position: float, length: int, rule: Rule, indices: NDArray[np.int64], weights: Reals) -> int:
    """Samples along an axis and their weights; returns how many."""
    whole = np.floor(position)
    t, first = position - whole, int(whole)
    if rule.interpolation == NEAREST:
        n_taps, weights[0] = 1, 1.0
    elif rule.interpolation == LINEAR:
        n_taps, weights[0], weights[1] = 2, 1 - t, t
    else:
        n_taps, first = 4, first - 1
        weights[0], weights[1], weights[2], weights[3] = _cubic_weights(t)
    for k in range(n_taps):
        index = first + k
        within = min(max(index, 0), length - 1)
        if rule.beyond == BLACK and within != index:
            weights[k] = 0.0
        indices[k] = index % length if rule.beyond == PERIODIC else within
    return n_taps
