"""The compiled filters of layers that every cell of the aperture only shifts.

A layer's samples lie phase by phase: of `o` samples a pixel, sample m = o x + f is column x of phase f, so that a row
of pixels reads contiguous memory wherever it starts.
Letters: `k` layer from far to near, `c` channel of premultiplied RGBA, `y x` pixel, `m` row of samples, `t` tap.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import compiled

Integers = NDArray[np.int64]
Reals = NDArray[np.floating]


class Smoothed(NamedTuple):
    """Layers that are seen together, from far to near."""

    samples: Reals
    """Premultiplied RGBA, blurred by a cell, [K, 4, rows, o, columns]."""
    first: Integers
    """First column of a row that is not transparent, [K, rows]."""
    last: Integers
    """One past the last such column, [K, rows]."""


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
                    _accumulate(across[t], line[(f + t) % n_phases, start : start + target.size], target)


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
        _accumulate(down[t], samples[source, begin:end], target)
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
def pick(samples: Reals, down: Reals, across: Reals, top: int, left: int, n_phases: int, result: Reals) -> None:
    """Add a filter's values at pixels.

    Args:
        samples: [C, h, w].
        down: Taps along a column.
        across: Taps along a row.
        top: Row of samples that the first tap reads for the first pixel.
        left: Likewise the column.
        n_phases: Samples a pixel.
        result: Changed, [C, H, W].
    """
    row = np.zeros(samples.shape[2], samples.dtype)
    line = np.zeros((n_phases, samples.shape[2] // n_phases), samples.dtype)
    width = result.shape[2]
    for y in range(result.shape[1]):
        for c in range(samples.shape[0]):
            row[:] = 0
            for t in range(down.size):
                _accumulate(down[t], samples[c, top + y * n_phases + t], row)
            _sort(row, line, 0)
            for t in range(across.size):
                start = (left + t) // n_phases
                _accumulate(across[t], line[(left + t) % n_phases, start : start + width], result[c, y])


@compiled
def _accumulate(weight: float, values: Reals, row: Reals) -> None:
    share = row.dtype.type(weight)
    for x in range(row.size):
        row[x] += share * values[x]
