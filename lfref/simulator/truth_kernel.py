"""The compiled loops of the truth: layers blurred by a cell, then composited through every cell of the aperture.

A layer's samples lie phase by phase: of `o` samples a pixel, sample m = o x + f is column x of phase f, so that a row
of pixels reads contiguous memory wherever it starts. A row of the picture is finished before the next one begins; the
rows of all layers that it reads for one row of cells are interpolated once and serve all cells of that row.
Letters: `k` layer from far to near, `c` channel of premultiplied RGBA, `j i` row and column of cells, `y x` pixel.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import compiled

Integers = NDArray[np.int64]
Reals = NDArray[np.floating]


class Layers(NamedTuple):
    """Layers that are seen together, from far to near."""

    samples: Reals
    """Premultiplied RGBA, blurred by a cell, [K, 4, rows, o, columns]."""
    first: Integers
    """First column of a row that is not transparent, [K, rows]."""
    last: Integers
    """One past the last such column, [K, rows]."""


class Positions(NamedTuple):
    """Where each layer is read, in samples, for pixel 0."""

    rows: Reals
    """For each row of cells, >= 0, float64, [K, J]."""
    columns: Reals
    """For each column of cells, >= 0, float64, [K, I]."""


@compiled
def smooth(samples: Reals, down: Reals, across: Reals, result: Reals, first: Integers, last: Integers) -> None:
    """Filter a layer along both axes where it is not transparent, and sort its columns by phase.

    Args:
        samples: Premultiplied RGBA, its ends going on beyond it, [4, rows, columns].
        down: Taps along a column, symmetric, odd in number.
        across: Taps along a row, symmetric, odd in number.
        result: Filled, [4, rows, o, columns / o].
        first: Filled: first column of each row that is not transparent, [rows].
        last: Filled: one past the last such column, [rows].
    """
    n_phases, n_columns = result.shape[2:]
    side, half = across.size // 2, down.size // 2
    begins, ends = _seen_spans(samples[3])
    row = np.zeros(samples.shape[2] + 2 * side + n_phases, samples.dtype)
    line = np.zeros((n_phases, row.size // n_phases), samples.dtype)
    for m in range(samples.shape[1]):
        near = slice(max(m - half, 0), m + half + 1)
        begin, end = begins[near].min(), ends[near].max()
        result[:, m] = 0
        first[m], last[m] = max(begin - side, 0) // n_phases, min((end + side - 1) // n_phases + 1, n_columns)
        if begin >= end:
            first[m] = last[m] = 0
            continue
        for c in range(4):
            _filter_down(samples[c], m, down, begin, end, side, row)
            _sort(row, line, first[m])
            for f in range(n_phases):
                target = result[c, m, f, first[m] : last[m]]
                for t in range(across.size):
                    start = first[m] + (f + t) // n_phases
                    _add(across[t], line[(f + t) % n_phases, start : start + target.size], target)


@compiled
def _seen_spans(opacity: Reals) -> tuple[Integers, Integers]:
    """First column of each row that is not transparent, and one past the last; [rows] each."""
    n_rows, n_columns = opacity.shape
    begins, ends = np.full(n_rows, n_columns), np.zeros(n_rows, np.int64)
    for m in range(n_rows):
        x = 0
        while x < n_columns and opacity[m, x] == 0:
            x += 1
        begins[m] = x
        end = n_columns
        while end > x and opacity[m, end - 1] == 0:
            end -= 1
        ends[m] = end if end > x else 0
    return begins, ends


@compiled
def _filter_down(samples: Reals, m: int, down: Reals, begin: int, end: int, side: int, row: Reals) -> None:
    """Row m of the filtered samples from column `begin` to before `end`, continued by `side` at both ends."""
    row[:] = 0
    target = row[side + begin : side + end]
    for t in range(down.size):
        source = min(max(m + t - down.size // 2, 0), samples.shape[0] - 1)
        _add(down[t], samples[source, begin:end], target)
    if begin == 0:
        row[:side] = row[side]
    if end == samples.shape[1]:
        row[side + end :] = row[side + end - 1]


@compiled
def _sort(row: Reals, line: Reals, first: int) -> None:
    """Columns of each phase side by side, from pixel column `first` on."""
    n_phases = line.shape[0]
    for f in range(n_phases):
        target = line[f]
        for x in range(first, target.size):
            target[x] = row[x * n_phases + f]


@compiled
def add_cells(layers: Layers, positions: Positions, weights: Reals, picture: Reals, top: int, end: int) -> None:
    """Composite the rows from `top` to before `end` of a picture through every cell.

    Args:
        layers: What is seen.
        positions: Where it is seen through each cell.
        weights: Share of each cell, of sum 1, [J, I].
        picture: Filled in these rows, [3, H, W].
        top: First row.
        end: One past the last row.
    """
    n_layers, n_phases = layers.samples.shape[0], layers.samples.shape[3]
    n_columns = layers.samples.shape[4]
    lines = np.zeros((n_layers, 4, n_phases, n_columns), layers.samples.dtype)
    spans = np.zeros((n_layers, 2), np.int64)
    sight = np.zeros((3, picture.shape[2]), layers.samples.dtype)
    for y in range(top, end):
        picture[:, y] = 0
        for j in range(weights.shape[0]):
            for k in range(n_layers):
                _read_line(layers, k, positions.rows[k, j] + y * n_phases, lines[k], spans[k])
            for i in range(weights.shape[1]):
                if weights[j, i] > 0:
                    sight[:] = 0
                    for k in range(n_layers):
                        if spans[k, 0] < spans[k, 1]:
                            _cover(lines[k], positions.columns[k, i], spans[k], sight)
                    for c in range(3):
                        _add(weights[j, i], sight[c], picture[c, y])


@compiled
def _read_line(layers: Layers, k: int, position: float, line: Reals, span: Integers) -> None:
    """Row of a layer at any height, between the two next to it."""
    m = int(position)
    share = line.dtype.type(position - m)
    rest = line.dtype.type(1) - share
    below = min(m + 1, layers.samples.shape[2] - 1)
    span[0] = min(layers.first[k, m], layers.first[k, below])
    span[1] = max(layers.last[k, m], layers.last[k, below])
    if span[0] >= span[1]:
        return
    for c in range(4):
        upper, lower = layers.samples[k, c, m], layers.samples[k, c, below]
        for f in range(line.shape[1]):
            target, a, b = line[c, f], upper[f], lower[f]
            for x in range(span[0], span[1]):
                target[x] = rest * a[x] + share * b[x]
            target[: span[0]] = 0
            target[span[1] :] = 0


@compiled
def _cover(line: Reals, position: float, span: Integers, sight: Reals) -> None:
    """Lay a row of a layer over what is seen so far."""
    n_phases, width = line.shape[1], sight.shape[1]
    m = int(position)
    share = line.dtype.type(position - m)
    one = line.dtype.type(1)
    rest = one - share
    f, g = m % n_phases, (m + 1) % n_phases
    p, q = m // n_phases, (m + 1) // n_phases
    begin, stop = max(0, span[0] - q), min(width, span[1] - p)
    if begin >= stop:
        return
    n = stop - begin
    p, q = p + begin, q + begin
    a0, a1, a2, a3 = line[0, f, p : p + n], line[1, f, p : p + n], line[2, f, p : p + n], line[3, f, p : p + n]
    b0, b1, b2, b3 = line[0, g, q : q + n], line[1, g, q : q + n], line[2, g, q : q + n], line[3, g, q : q + n]
    s0, s1, s2 = sight[0, begin:stop], sight[1, begin:stop], sight[2, begin:stop]
    for x in range(n):
        passed = one - (rest * a3[x] + share * b3[x])
        s0[x] = rest * a0[x] + share * b0[x] + passed * s0[x]
        s1[x] = rest * a1[x] + share * b1[x] + passed * s1[x]
        s2[x] = rest * a2[x] + share * b2[x] + passed * s2[x]


@compiled
def _add(weight: float, sight: Reals, row: Reals) -> None:
    share = sight.dtype.type(weight)
    for x in range(row.size):
        row[x] += share * sight[x]
