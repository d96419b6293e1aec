"""What the compiled loop of shifts takes: tables made from positions in samples, and where a bitmap is not empty."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from lfref.functional.jit import compiled, inlined
from lfref.simulator import lookups

# PART shift_loop
# The compiled inner loops: bitmaps read at shifted pixels, row by row, and laid over what is farther.
#
# A shift is the same for all pixels of a view, so that it is carried out axis by axis: four rows of the bitmap become
# one line, once for all views of a view row, and four stretches of the line become a row of a view. Even and odd
# columns of a line are kept apart, so that every loop runs over neighbours in memory.
# Letters: `v u` view row and column, `c` channel, `y x` pixel, `h w` rows and columns of the bitmap in samples.

PAD = 4
"""Pairs of columns that a line goes on beyond its bitmap, black."""

Integers = NDArray[np.int64]
Reals = NDArray[np.float32]
Quadruple = tuple[np.floating, np.floating, np.floating, np.floating]


class Sheet(NamedTuple):
    """A bitmap, and where it is not empty."""

    samples: Reals
    """The last channel is opacity where it is laid over others; w is even, [C, h, w]."""
    begins: Integers
    """First column of each row that is not empty, [h]."""
    ends: Integers
    """One past the last one, [h]."""


class Shifts(NamedTuple):
    """Where the pixels of n pictures read along one axis: pixel 0 from `starts` on, each further one two samples on."""

    starts: Integers
    """First of four samples, [n]."""
    weights: Reals
    """[n, 4]."""


@compiled
def over(sheet: Sheet, across: Shifts, down: Shifts, picture: Reals, top: int, end: int) -> None:
    """Lay a surface over the rows from `top` to before `end` of all views.

    Args:
        sheet: Premultiplied colours, and opacity unless it is opaque all over, [3 or 4, h, w].
        across: Of the view columns.
        down: Of the view rows.
        picture: What is farther; changed, [V, U, 3, H, W].
        top: First row.
        end: One past the last row.
    """
    lines = np.zeros((sheet.samples.shape[0], 2, sheet.samples.shape[2] // 2 + 2 * PAD), np.float32)
    veil = np.empty((2, picture.shape[4]), np.float32)
    for y in range(top, end):
        for v in range(picture.shape[0]):
            begin, stop = _lay(sheet, down.starts[v] + 2 * y, down.weights[v], lines)
            for u in range(picture.shape[1] if begin < stop else 0):
                start, weights = across.starts[u], across.weights[u]
                left, right = read_span(start, begin, stop, picture.shape[4])
                if left < right:
                    _cover(lines, start, weights, left, right, veil, picture[v, u, :, y])


@inlined
def _lay(sheet: Sheet, first: int, weights: Reals, lines: Reals) -> tuple[int, int]:
    """Four rows of the bitmap, from `first` on, as one line each channel; the pairs of columns that are not empty."""
    height = sheet.samples.shape[1]
    begin, end = sheet.samples.shape[2], 0
    for row in range(max(first, 0), min(first + 4, height)):
        begin, end = min(begin, sheet.begins[row]), max(end, sheet.ends[row])
    begin, end = begin // 2, (end + 1) // 2
    if begin >= end:
        return 0, 0
    lay_lines(sheet.samples, first, weights, begin, end, lines)
    return begin, end


@inlined
def lay_lines(samples: Reals, first: int, weights: Reals, begin: int, end: int, lines: Reals) -> None:
    """Four rows of a bitmap [C, h, w], from `first` on, as one line each channel, between two pairs of columns."""
    height = samples.shape[1]
    # Beyond its first and last row a bitmap is empty.
    w0, w1, w2, w3 = (
        _within(weights, 0, first, height),
        _within(weights, 1, first, height),
        _within(weights, 2, first, height),
        _within(weights, 3, first, height),
    )
    r0, r1, r2, r3 = (
        min(max(first, 0), height - 1),
        min(max(first + 1, 0), height - 1),
        min(max(first + 2, 0), height - 1),
        min(max(first + 3, 0), height - 1),
    )
    for c in range(samples.shape[0]):
        rows, line = samples[c], lines[c]
        line[:, PAD + begin - 2 : PAD + begin] = 0
        line[:, PAD + end : PAD + end + 2] = 0
        span = slice(2 * begin, 2 * end)
        _mix_rows(
            rows[r0, span],
            rows[r1, span],
            rows[r2, span],
            rows[r3, span],
            (w0, w1, w2, w3),
            line[0, PAD + begin : PAD + end],
            line[1, PAD + begin : PAD + end],
        )


@inlined
def _within(weights: Reals, tap: int, first: int, height: int) -> np.float32:
    return weights[tap] if 0 <= first + tap < height else np.float32(0)


@compiled
def _mix_rows(
    r0: Reals,
    r1: Reals,
    r2: Reals,
    r3: Reals,
    weights: Quadruple,
    even: Reals,
    odd: Reals,
) -> None:
    """The weighted sum of four rows, their even and odd columns apart."""
    w0, w1, w2, w3 = weights
    for i in range(even.size):
        even[i] = w0 * r0[2 * i] + w1 * r1[2 * i] + w2 * r2[2 * i] + w3 * r3[2 * i]
        odd[i] = w0 * r0[2 * i + 1] + w1 * r1[2 * i + 1] + w2 * r2[2 * i + 1] + w3 * r3[2 * i + 1]


@inlined
def read_span(start: int, begin: int, end: int, width: int) -> tuple[int, int]:
    """Pixels that read any of the pairs of columns from `begin` to before `end`."""
    left = max(0, (2 * begin - 2 - start) // 2)
    return left, max(left, min(width, (2 * end - start + 1) // 2))


@inlined
def _stretch(line: Reals, start: int, tap: int, left: int, right: int) -> Reals:
    """What one tap reads for the pixels from `left` to before `right`."""
    first = PAD + ((start + tap) >> 1)
    return line[(start + tap) & 1, first + left : first + right]


@inlined
def put(line: Reals, start: int, weights: Reals, left: int, right: int, row: Reals) -> None:
    """A shifted line in place of what is there."""
    _mix(
        _stretch(line, start, 0, left, right),
        _stretch(line, start, 1, left, right),
        _stretch(line, start, 2, left, right),
        _stretch(line, start, 3, left, right),
        weights,
        row[left:right],
    )


@inlined
def _cover(lines: Reals, start: int, weights: Reals, left: int, right: int, veil: Reals, row: Reals) -> None:
    """Shifted lines over a row of a view, [3, W]."""
    if lines.shape[0] == 3:
        for c in range(3):
            put(lines[c], start, weights, left, right, row[c])
            _darken(row[c, left:right])
        return
    opacity, colour = veil[0, left:right], veil[1, left:right]
    put(lines[3], start, weights, left, right, veil[0])
    for c in range(3):
        put(lines[c], start, weights, left, right, veil[1])
        _blend(colour, opacity, row[c, left:right])


@compiled
def _mix(s0: Reals, s1: Reals, s2: Reals, s3: Reals, weights: Reals, row: Reals) -> None:
    w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
    for x in range(row.size):
        row[x] = w0 * s0[x] + w1 * s1[x] + w2 * s2[x] + w3 * s3[x]


@compiled
def _darken(row: Reals) -> None:
    """No light below 0, as a cubic makes it beside edges."""
    for x in range(row.size):
        row[x] = max(row[x], np.float32(0))


@compiled
def _blend(colour: Reals, opacity: Reals, row: Reals) -> None:
    one, zero = np.float32(1), np.float32(0)
    for x in range(row.size):
        passed = one - min(max(opacity[x], zero), one)
        row[x] = legal(colour[x], opacity[x]) + passed * row[x]


@inlined
def legal(colour: np.float32, opacity: np.float32) -> np.float32:
    """A premultiplied colour as `lookups.legal` makes it, where a cubic has driven it or its opacity out of [0, 1]."""
    zero = np.float32(0)
    return max(colour, zero) / max(opacity, np.float32(1)) if opacity > zero else zero


def shifts(first: Tensor) -> Shifts:
    """Tables of one axis.

    Args:
        first: What pixel 0 of each picture reads, in samples, float64, [n].
    """
    whole = first.floor()
    weights = lookups.cubic_weights(first - whole).float()
    return Shifts((whole.long() - 1).numpy(), weights.numpy())


def filled(samples: NDArray[np.float32]) -> Sheet:
    """A bitmap [C, h, w] that is read everywhere."""
    height, width = samples.shape[1:]
    return Sheet(samples, np.zeros(height, np.int64), np.full(height, width))


def outlined(samples: NDArray[np.float32]) -> Sheet:
    """A bitmap [4, h, w] that is read where its last channel is not 0."""
    is_seen = samples[3] != 0
    width = is_seen.shape[1]
    begins = np.where(is_seen.any(axis=1), is_seen.argmax(axis=1), width)
    return Sheet(samples, begins, width - np.where(begins < width, is_seen[:, ::-1].argmax(axis=1), width))
