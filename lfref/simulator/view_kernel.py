"""The compiled inner loops: bitmaps read at shifted pixels, row by row, and laid over what is farther.

A shift is the same for all pixels of a view, so that it is carried out axis by axis: four rows of the bitmap become
one line, once for all views of a view row, and four stretches of the line become a row of a view. Even and odd
columns of a line are kept apart, so that every loop runs over neighbours in memory.
Letters: `v u` view row and column, `c` channel, `y x` pixel, `h w` rows and columns of the bitmap in samples.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import compiled, inlined

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
                left, right = _span(start, begin, stop, picture.shape[4])
                if left < right:
                    _cover(lines, start, weights, left, right, veil, picture[v, u, :, y])


@compiled
def read(sheet: Sheet, across: Shifts, down: Shifts, pictures: Reals) -> None:
    """Read a bitmap for pictures that each have a shift of their own.

    Args:
        sheet: The bitmap.
        across: Of the pictures' columns.
        down: Of the pictures' rows.
        pictures: Filled, black at first, [M, C, H, W].
    """
    lines = np.zeros((sheet.samples.shape[0], 2, sheet.samples.shape[2] // 2 + 2 * PAD), np.float32)
    for m in range(pictures.shape[0]):
        start, weights = across.starts[m], across.weights[m]
        for y in range(pictures.shape[2]):
            begin, stop = _lay(sheet, down.starts[m] + 2 * y, down.weights[m], lines)
            left, right = _span(start, begin, stop, pictures.shape[3])
            for c in range(pictures.shape[1] if begin < stop and left < right else 0):
                _put(lines[c], start, weights, left, right, pictures[m, c, y])


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
    for c in range(sheet.samples.shape[0]):
        rows, line = sheet.samples[c], lines[c]
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
    return begin, end


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
def _span(start: int, begin: int, end: int, width: int) -> tuple[int, int]:
    """Pixels that read any of the pairs of columns from `begin` to before `end`."""
    left = max(0, (2 * begin - 2 - start) // 2)
    return left, max(left, min(width, (2 * end - start + 1) // 2))


@inlined
def _stretch(line: Reals, start: int, tap: int, left: int, right: int) -> Reals:
    """What one tap reads for the pixels from `left` to before `right`."""
    first = PAD + ((start + tap) >> 1)
    return line[(start + tap) & 1, first + left : first + right]


@inlined
def _put(line: Reals, start: int, weights: Reals, left: int, right: int, row: Reals) -> None:
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
            _put(lines[c], start, weights, left, right, row[c])
            _darken(row[c, left:right])
        return
    alpha, scale = veil[0, left:right], veil[1, left:right]
    _put(lines[3], start, weights, left, right, veil[0])
    _limit(alpha, scale)
    for c in range(3):
        line = lines[c]
        _blend(
            _stretch(line, start, 0, left, right),
            _stretch(line, start, 1, left, right),
            _stretch(line, start, 2, left, right),
            _stretch(line, start, 3, left, right),
            weights,
            alpha,
            scale,
            row[c, left:right],
        )


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
def _limit(alpha: Reals, scale: Reals) -> None:
    """Opacities that a cubic has driven out of [0, 1] made legal, and what colours must be multiplied by for it."""
    one, zero = np.float32(1), np.float32(0)
    for x in range(alpha.size):
        opacity = alpha[x]
        scale[x] = one / max(opacity, one) if opacity > zero else zero
        alpha[x] = min(max(opacity, zero), one)


@compiled
def _blend(s0: Reals, s1: Reals, s2: Reals, s3: Reals, weights: Reals, alpha: Reals, scale: Reals, row: Reals) -> None:
    one, zero = np.float32(1), np.float32(0)
    w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
    for x in range(row.size):
        colour = w0 * s0[x] + w1 * s1[x] + w2 * s2[x] + w3 * s3[x]
        row[x] = row[x] * (one - alpha[x]) + scale[x] * max(colour, zero)


@compiled
def read_anywhere(samples: Reals, i: NDArray[np.float64], j: NDArray[np.float64], result: Reals) -> None:
    """Read a bitmap at any points, its ends going on beyond it.

    Args:
        samples: The channels of a sample side by side, [h, w, 4].
        i: Columns in samples, [n].
        j: Rows in samples, [n].
        result: Filled, [4, n].
    """
    height, width = samples.shape[:2]
    for point in range(i.size):
        column, row = np.floor(i[point]), np.floor(j[point])
        across, down = _weights(np.float32(i[point] - column)), _weights(np.float32(j[point] - row))
        first, top = _clamped(column, width) - 1, _clamped(row, height) - 1
        c0 = c1 = c2 = c3 = np.float32(0)
        for b in range(4):
            line = samples[min(max(top + b, 0), height - 1)]
            for a in range(4):
                weight = across[a] * down[b]
                sample = line[min(max(first + a, 0), width - 1)]
                c0 += weight * sample[0]
                c1 += weight * sample[1]
                c2 += weight * sample[2]
                c3 += weight * sample[3]
        result[0, point], result[1, point], result[2, point], result[3, point] = c0, c1, c2, c3


@inlined
def _clamped(position: float, length: int) -> int:
    return int(min(max(position, -4.0), length + 4.0))


@inlined
def _weights(t: np.float32) -> Quadruple:
    """Keys' weights, as in `lookups`."""
    half, squared = np.float32(0.5), t * t
    cubed = squared * t
    return (
        squared - half * (t + cubed),
        np.float32(1) - np.float32(2.5) * squared + np.float32(1.5) * cubed,
        half * t + np.float32(2) * squared - np.float32(1.5) * cubed,
        half * (cubed - squared),
    )
