"""Layers that face the camera: the compiled loops that read a bitmap at shifted pixels and lay it over a picture.

A shift is the same for all pixels of a view, so that it is carried out axis by axis. Four rows of the bitmap become one
interpolated line, once for all views of a view row; four stretches of that line become a row of pixels of one view.
With two samples per pixel, a pixel reads every other column of a line: even and odd columns are kept apart, so that
every inner loop runs over neighbours in memory.
Letters: `v u` view row and column, `c` channel, `y x` pixel, `h w` rows and columns of the bitmap in samples.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from lfref.functional.loops import compiled, inlined
from lfref.simulator import bitmaps
from lfref.simulator.bitmaps import Quadruple

PAD = 2
"""Pairs of black columns on each side of a line: a cubic reads that many beyond the bitmap."""

Integers = NDArray[np.int64]
Float32s = NDArray[np.float32]


class TrimmedBitmap(NamedTuple):
    """A bitmap, and the part of each row that is not transparent."""

    samples: Float32s  # premultiplied colours, and opacity unless it is opaque all over; w is even, [3 or 4, h, w]
    begins: Integers  # first column that is not transparent in each row, [h]
    ends: Integers  # one past the last such column, [h]


class ShiftTaps(NamedTuple):
    """Cubic look-ups of n pictures along one axis: pixel x reads the four samples from `starts + 2 x` on."""

    starts: Integers  # first of the four samples of pixel 0, [n]
    weights: Float32s  # [n, 4]


def shift_taps(first: Tensor) -> ShiftTaps:
    """Look-ups along one axis from the position that pixel 0 of each picture reads, in samples, float64, [n]."""
    whole = first.floor()
    weights = bitmaps.cubic_weights(first - whole).float()
    return ShiftTaps((whole.long() - 1).numpy(), weights.numpy())


def trimmed(samples: NDArray[np.float32], is_opaque: bool) -> TrimmedBitmap:
    """A bitmap [4, h, w] with the part of each row whose opacity, the last channel, is not 0."""
    if is_opaque:
        height, width = samples.shape[1:]
        return TrimmedBitmap(samples[:3], np.zeros(height, np.int64), np.full(height, width))
    is_visible = samples[3] != 0
    width = is_visible.shape[1]
    begins = np.where(is_visible.any(axis=1), is_visible.argmax(axis=1), width)
    return TrimmedBitmap(samples, begins, width - np.where(begins < width, is_visible[:, ::-1].argmax(axis=1), width))


@compiled
def composite_shifted(
    bitmap: TrimmedBitmap, across: ShiftTaps, down: ShiftTaps, picture: Float32s, top: int, end: int
) -> None:
    """Lay a surface over rows of views [V, U, 3, H, W], by the look-ups of view columns (`across`) and rows."""
    lines = np.zeros((bitmap.samples.shape[0], 2, bitmap.samples.shape[2] // 2 + 2 * PAD), np.float32)
    row = np.empty((2, picture.shape[4]), np.float32)
    for y in range(top, end):
        for v in range(picture.shape[0]):
            # First down: row y of the views reads the four rows of the bitmap from `starts + 2 y` on. They give one
            # line for the whole view row, only where one of them is not transparent. Then across, for each view.
            begin, stop = _interpolate_visible(bitmap, down.starts[v] + 2 * y, down.weights[v], lines)
            for u in range(picture.shape[1] if begin < stop else 0):
                start, weights = across.starts[u], across.weights[u]
                left, right = pixels_reading(start, begin, stop, picture.shape[4])
                if left < right:
                    _composite_row(lines, start, weights, left, right, row, picture[v, u, :, y])


@inlined
def _interpolate_visible(bitmap: TrimmedBitmap, first: int, weights: Float32s, lines: Float32s) -> tuple[int, int]:
    """Interpolate four rows from `first` on; returns the range of pairs of columns that are not transparent."""
    height = bitmap.samples.shape[1]
    begin, end = bitmap.samples.shape[2], 0
    for row in range(max(first, 0), min(first + 4, height)):
        begin, end = min(begin, bitmap.begins[row]), max(end, bitmap.ends[row])
    begin, end = begin // 2, (end + 1) // 2
    if begin >= end:
        return 0, 0
    interpolate_rows(bitmap.samples, first, weights, begin, end, lines)
    return begin, end


@inlined
def interpolate_rows(samples: Float32s, first: int, weights: Float32s, begin: int, end: int, lines: Float32s) -> None:
    """Fill one line per channel from four rows of a bitmap [C, h, w], `first` on, from pair `begin` to before `end`."""
    last = samples.shape[1] - 1
    # Beyond its first and last row a bitmap is transparent: such rows get the weight 0 and any valid index.
    w0 = weights[0] if 0 <= first <= last else np.float32(0)
    w1 = weights[1] if 0 <= first + 1 <= last else np.float32(0)
    w2 = weights[2] if 0 <= first + 2 <= last else np.float32(0)
    w3 = weights[3] if 0 <= first + 3 <= last else np.float32(0)
    r0, r1 = min(max(first, 0), last), min(max(first + 1, 0), last)
    r2, r3 = min(max(first + 2, 0), last), min(max(first + 3, 0), last)
    for c in range(samples.shape[0]):
        rows, line = samples[c], lines[c]
        # Lines are reused: black pairs on each side erase what a cubic might still read of the last line.
        line[:, begin : PAD + begin] = 0
        line[:, PAD + end : PAD + end + PAD] = 0
        span = slice(2 * begin, 2 * end)
        even, odd = line[0, PAD + begin : PAD + end], line[1, PAD + begin : PAD + end]
        _mix_rows(rows[r0, span], rows[r1, span], rows[r2, span], rows[r3, span], (w0, w1, w2, w3), even, odd)


@compiled
def _mix_rows(
    r0: Float32s, r1: Float32s, r2: Float32s, r3: Float32s, weights: Quadruple, even: Float32s, odd: Float32s
) -> None:
    """The weighted sum of four rows, its even and odd columns apart."""
    w0, w1, w2, w3 = weights
    for i in range(even.size):
        even[i] = w0 * r0[2 * i] + w1 * r1[2 * i] + w2 * r2[2 * i] + w3 * r3[2 * i]
        odd[i] = w0 * r0[2 * i + 1] + w1 * r1[2 * i + 1] + w2 * r2[2 * i + 1] + w3 * r3[2 * i + 1]


@inlined
def pixels_reading(start: int, begin: int, end: int, width: int) -> tuple[int, int]:
    """Pixels of a row that read any of the pairs of columns from `begin` to before `end`."""
    left = max(0, (2 * begin - 2 - start) // 2)
    return left, max(left, min(width, (2 * end - start + 1) // 2))


@inlined
def _tap_values(line: Float32s, start: int, tap: int, left: int, right: int) -> Float32s:
    """Values that one tap reads for the pixels from `left` to before `right`: neighbours in an even or odd line."""
    first = PAD + ((start + tap) >> 1)
    return line[(start + tap) & 1, first + left : first + right]


@inlined
def read_shifted(line: Float32s, start: int, weights: Float32s, left: int, right: int, row: Float32s) -> None:
    """Fill the pixels from `left` to before `right` of a row from a shifted line."""
    s0, s1 = _tap_values(line, start, 0, left, right), _tap_values(line, start, 1, left, right)
    s2, s3 = _tap_values(line, start, 2, left, right), _tap_values(line, start, 3, left, right)
    _mix(s0, s1, s2, s3, weights, row[left:right])


@inlined
def _composite_row(
    lines: Float32s, start: int, weights: Float32s, left: int, right: int, row: Float32s, behind: Float32s
) -> None:
    """Lay shifted lines over a row of a view, `behind` [3, W]; `row` [2, W] is scratch memory."""
    if lines.shape[0] == 3:
        # An opaque surface replaces what is behind it.
        for c in range(3):
            read_shifted(lines[c], start, weights, left, right, behind[c])
            _clamp_below(behind[c, left:right])
        return
    opacity, colour = row[0, left:right], row[1, left:right]
    read_shifted(lines[3], start, weights, left, right, row[0])
    for c in range(3):
        read_shifted(lines[c], start, weights, left, right, row[1])
        _blend(colour, opacity, behind[c, left:right])


@compiled
def _mix(s0: Float32s, s1: Float32s, s2: Float32s, s3: Float32s, weights: Float32s, row: Float32s) -> None:
    w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
    for x in range(row.size):
        row[x] = w0 * s0[x] + w1 * s1[x] + w2 * s2[x] + w3 * s3[x]


@compiled
def _clamp_below(row: Float32s) -> None:
    """No light below 0: a cubic undershoots beside edges."""
    for x in range(row.size):
        row[x] = max(row[x], np.float32(0))


@compiled
def _blend(colour: Float32s, opacity: Float32s, behind: Float32s) -> None:
    one, zero = np.float32(1), np.float32(0)
    for x in range(behind.size):
        passed = one - min(max(opacity[x], zero), one)
        behind[x] = clipped_colour(colour[x], opacity[x]) + passed * behind[x]


@inlined
def clipped_colour(colour: np.float32, opacity: np.float32) -> np.float32:
    """A premultiplied colour without the overshoot of a cubic, as in `bitmaps.clip_premultiplied`."""
    zero = np.float32(0)
    return max(colour, zero) / max(opacity, np.float32(1)) if opacity > zero else zero
