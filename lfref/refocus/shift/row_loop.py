"""The compiled inner loops of shift-and-sum: each source row is read once and serves every plane.

For a row y of the U views of one view row, and for each plane, one pass adds up the horizontally shifted views; the
sum goes, weighted, into the output rows that it lies between. All of that stays in the first two caches: U source rows
as floating point, one row of sums, and a ring of unfinished output rows a plane, written out once when complete.
Source rows that need neither conversion nor what lies beyond their ends are not copied: what a pass reads there is
summed again, by the taps that count.
Letters: `n` plane, `v u` view row and column, `c` channel, `y x` source row and column, `r` output row, `k` tap.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import compiled, inlined
from lfref.functional.row_sums import TAPS, add_taps, set_taps

Integers = NDArray[np.int64]
Reals = NDArray[np.floating]


class Source(NamedTuple):
    """Views where they lie in memory, and what continues them beyond their edges."""

    samples: NDArray
    """Memory of the views, any type, one axis."""
    direct: Reals
    """The same where rows can be read as they lie there, neither converted nor continued; else empty."""
    starts: Integers
    """`Horizontal.starts`, but in the views' own rows, counted from `reach` before the first, [N, R, G, TAPS]."""
    last: int
    """Last place in `direct` from which all of these taps stay within it; -1: none."""
    strides: Integers
    """Steps in it along v, u, c, y, x."""
    n_columns: int
    """View columns, U."""
    rows: Integers
    """Source row of each row from -reach to H + reach; -1: black, [H + 2 reach]."""
    columns: Integers
    """The same for columns, the end filled up to whole vectors, [reach + W + reach + ...]."""


class Horizontal(NamedTuple):
    """Taps of the horizontal pass, `TAPS` at a time in G groups; those of weight 0 fill up the last group.

    R is 1 where all view rows stand at the same columns, else V.
    """

    starts: Integers
    """Where in the U rows (one after the other) each tap reads for x = 0, [N, R, G, TAPS]."""
    weights: Reals
    """[N, V, G, TAPS]."""
    groups: Integers
    """Groups in use, [N]."""
    begins: Integers
    """First column that each tap serves, [N, R, G, TAPS]."""
    ends: Integers
    """One past the last column that each tap serves, [N, R, G, TAPS]."""
    left: Integers
    """First column that all taps serve, [N, R]."""
    right: Integers
    """One past the last column that all taps serve, [N, R]."""


class Vertical(NamedTuple):
    """Taps of the vertical pass: source row y serves output row y - offset."""

    offsets: Integers
    """[N, V, M]."""
    weights: Reals
    """[N, V, M]."""
    begins: Integers
    """First output row that each view row serves, [N, V]."""
    ends: Integers
    """One past the last output row that each view row serves, [N, V]."""
    lowest: Integers
    """Least offset, [N]."""
    highest: Integers
    """Greatest offset, [N]."""
    least: int
    """Least of all offsets."""
    most: int
    """Greatest of all offsets."""


class Scale(NamedTuple):
    """What the sums are multiplied by; rows of one kind share their factors."""

    factors: Reals
    """[N, kinds, W]."""
    kinds: Integers
    """[N, H]."""


class Scratch(NamedTuple):
    """What one thread works in."""

    rows: Reals
    """The U source rows, continued beyond their ends, [U, ...]."""
    total: Reals
    """One row of sums, [W rounded up]."""
    ring: Reals
    """Unfinished output rows, used in turn, those of all planes one after the other."""
    first: Integers
    """Where each plane's begin, and the end, [N + 1]."""


@compiled
def add_band(
    source: Source,
    across: Horizontal,
    down: Vertical,
    scale: Scale,
    scratch: Scratch,
    stack: Reals,
    top: int,
    end: int,
) -> None:
    """Refocus the rows from `top` to before `end` of a stack.

    Args:
        source: The views.
        across: Taps of the horizontal pass.
        down: Taps of the vertical pass.
        scale: Factors of the sums.
        scratch: To work in, black.
        stack: Filled in these rows, [N, C, H, W].
        top: First row.
        end: One past the last row.
    """
    reach = (source.rows.size - stack.shape[2]) // 2
    for c in range(stack.shape[1]):
        for y in range(top + down.least, end + down.most):
            y_source = source.rows[y + reach]
            for v in range(across.weights.shape[1] if y_source >= 0 else 0):
                first = v * source.strides[0] + c * source.strides[2] + y_source * source.strides[3] - reach
                if 0 <= first <= source.last:
                    rows, starts = source.direct[first:], source.starts
                else:
                    _gather(source, v, c, y_source, scratch.rows, reach, stack.shape[3])
                    rows, starts = scratch.rows.reshape(-1), across.starts
                _serve_planes(rows, starts, scratch, v, y, across, down, stack.shape[3], top, end)
            for n in range(stack.shape[0]):
                r = y - down.highest[n]
                if top <= r < end:
                    _finish(_unfinished(scratch, n, r), scale.factors[n, scale.kinds[n, r]], stack[n, c, r])


@inlined
def _unfinished(scratch: Scratch, n: int, r: int) -> Reals:
    return scratch.ring[scratch.first[n] + r % (scratch.first[n + 1] - scratch.first[n])]


@inlined
def _gather(source: Source, v: int, c: int, y: int, rows: Reals, reach: int, width: int) -> None:
    """Copy row y of the views of view row v, continued beyond both ends."""
    strides, columns = source.strides, source.columns
    for u in range(source.n_columns):
        first = v * strides[0] + u * strides[1] + c * strides[2] + y * strides[3]
        row, step = rows[u], strides[4]
        if step == 1:
            line, inner = source.samples[first : first + width], row[reach : reach + width]
            for x in range(width):
                inner[x] = line[x]
        else:
            for x in range(width):
                row[reach + x] = source.samples[first + x * step]
        for x in range(reach):
            row[x] = row[reach + columns[x]] if columns[x] >= 0 else 0
        for x in range(reach + width, row.size):
            row[x] = row[reach + columns[x]] if columns[x] >= 0 else 0


@inlined
def _serve_planes(
    rows: Reals,
    starts: Integers,
    scratch: Scratch,
    v: int,
    y: int,
    across: Horizontal,
    down: Vertical,
    width: int,
    top: int,
    end: int,
) -> None:
    """Add source row y of view row v to the unfinished output rows of every plane."""
    total, line = scratch.total, v if starts.shape[1] > 1 else 0
    for n in range(scratch.first.size - 1):
        begin, stop = max(top, down.begins[n, v]), min(end, down.ends[n, v])
        is_summed = False
        for m in range(down.offsets.shape[2]):
            r, weight = y - down.offsets[n, v, m], down.weights[n, v, m]
            if begin <= r < stop and weight != 0:
                if not is_summed:
                    _sum_row(rows, starts[n, line], across, n, v, line, total, width)
                    is_summed = True
                _add(weight, total, _unfinished(scratch, n, r))


@inlined
def _sum_row(
    rows: Reals, starts: Integers, across: Horizontal, n: int, v: int, line: int, total: Reals, width: int
) -> None:
    """The shifted views of one view row added up for one plane."""
    weights, begins, ends = across.weights[n, v], across.begins[n, line], across.ends[n, line]
    left, right = across.left[n, line], across.right[n, line]
    set_taps(rows, starts[0], weights[0], total)
    for g in range(1, across.groups[n]):
        add_taps(rows, starts[g], weights[g], total)
    if left > 0:
        _sum_edge(rows, starts, weights, begins, ends, total, 0, left)
    if right < width:
        _sum_edge(rows, starts, weights, begins, ends, total, right, width)


@compiled
def _sum_edge(
    rows: Reals,
    starts: Integers,
    weights: Reals,
    begins: Integers,
    ends: Integers,
    total: Reals,
    left: int,
    right: int,
) -> None:
    """Sum again, tap by tap, the columns from left to right that not every tap serves."""
    for x in range(left, right):
        total[x] = 0
    for g in range(starts.shape[0]):
        for k in range(TAPS):
            weight, start = weights[g, k], starts[g, k]
            for x in range(max(left, begins[g, k]), min(right, ends[g, k])):
                total[x] += weight * rows[start + x]


@compiled
def _add(weight: float, total: Reals, row: Reals) -> None:
    for x in range(total.size):
        row[x] += weight * total[x]


@compiled
def _finish(row: Reals, factors: Reals, result: Reals) -> None:
    """Write a complete row out, and leave it black for the next use."""
    for x in range(result.size):
        result[x] = row[x] * factors[x]
    row[:] = 0
