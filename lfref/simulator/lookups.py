"""The compiled look-ups of bitmaps at any points: cubic, as in `lookups`, and linear.

A bitmap's channels lie side by side, in a row of values that may hold other bitmaps too; its ends go on beyond it.
Letters: `i j` column and row in samples, `t` fraction of a sample.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.functional import splines
from lfref.functional.jit import inlined

# PART lookups
# Reading a painted bitmap between its samples, by Keys' cubic convolution.
#
# Letters: `h w` rows and columns of the bitmap, `i j` column and row in samples, `t` fraction of a sample. Source:
# Keys,
# "Cubic convolution interpolation for digital image processing", 1981 (a = -1/2, which reproduces quadratics).

TAPS = 4


def cubic_weights(t: Tensor) -> Tensor:
    """Weights of the samples at -1, 0, 1 and 2 for positions between 0 and 1.

    Args:
        t: Positions, [...].

    Returns:
        [..., 4].
    """
    return torch.stack(splines.weights(t), dim=-1)


def taps(position: Tensor, length: int) -> tuple[Tensor, Tensor]:
    """Which samples to read along one axis, and their weights.

    Args:
        position: In samples, float64, [...].
        length: Of the axis; its ends go on beyond it.

    Returns:
        Places, int64, [..., 4], and weights, float32, [..., 4].
    """
    whole = position.floor()
    weights = cubic_weights((position - whole).float())
    first = whole.clamp(-TAPS, length + TAPS).long() - 1
    offsets = torch.arange(TAPS, device=position.device)
    return (first[..., None] + offsets).clamp(0, length - 1), weights


def anywhere(bitmap: Tensor, i: Tensor, j: Tensor) -> Tensor:
    """The bitmap at any positions.

    Args:
        bitmap: [C, h, w].
        i: Columns in samples, float64, [M, H, W].
        j: Rows in samples, float64, [M, H, W].

    Returns:
        [M, C, H, W].
    """
    n_channels, height, width = bitmap.shape
    samples = bitmap.movedim(0, -1).reshape(-1, n_channels)
    columns, across = taps(i, width)
    rows, down = taps(j, height)
    result = samples.new_zeros(*i.shape, n_channels)
    for row in range(TAPS):
        line = torch.zeros_like(result)
        for column in range(TAPS):
            line += samples[rows[..., row] * width + columns[..., column]] * across[..., column, None]
        result += line * down[..., row, None]
    return result.movedim(-1, -3)


def on_grid(bitmap: Tensor, i: Tensor, j: Tensor) -> Tensor:
    """The bitmap on grids, axis by axis.

    Args:
        bitmap: [C, h, w].
        i: Columns in samples, float64, [M, 1, W].
        j: Rows in samples, float64, [M, H, 1].

    Returns:
        [M, C, H, W].
    """
    rows, down = taps(j[..., 0], bitmap.shape[-2])
    columns, across = taps(i[:, 0], bitmap.shape[-1])
    lines = sum(bitmap[:, rows[..., k]] * down[..., k, None] for k in range(TAPS))
    assert isinstance(lines, Tensor)
    shape = (*lines.shape[:-1], columns.shape[1])
    result = sum(lines.gather(-1, columns[:, None, :, k].expand(shape)) * across[:, None, :, k] for k in range(TAPS))
    assert isinstance(result, Tensor)
    return result.movedim(0, 1)


def linear(bitmap: Tensor, i: Tensor, j: Tensor) -> Tensor:
    """The bitmap at any positions, its ends going on beyond it; arguments and result as for `anywhere`."""
    n_channels, height, width = bitmap.shape
    samples = bitmap.movedim(0, -1).reshape(-1, n_channels)
    i, j = i.clamp(0, width - 1), j.clamp(0, height - 1)
    column, row = i.long().clamp(max=width - 2), j.long().clamp(max=height - 2)
    across, down = ((at - whole).to(samples)[..., None] for at, whole in ((i, column), (j, row)))
    first = row * width + column
    upper = torch.lerp(samples[first], samples[first + 1], across)
    lower = torch.lerp(samples[first + width], samples[first + width + 1], across)
    return torch.lerp(upper, lower, down).movedim(-1, -3)


def legal(rgba: Tensor) -> Tensor:
    """Premultiplied colours without the excess that a cubic makes beside edges: none below 0, opacity at most 1.

    Where opacity is more than 1, colours are scaled as it is, so that edges of a surface do not shine.

    Args:
        rgba: [..., 4, H, W].
    """
    alpha = rgba.narrow(-3, 3, 1)
    return torch.where(alpha > 0, rgba.clamp(min=0) / alpha.clamp(min=1), 0)


Reals = NDArray[np.floating]
Quadruple = tuple[np.floating, np.floating, np.floating, np.floating]
"""Weights of four samples, or red, green, blue and opacity."""


@inlined
def cubic_of_look_loop(samples: Reals, start: int, rows: int, columns: int, i: float, j: float) -> Quadruple:
    """Four channels at a point.

    Args:
        samples: Values, [all].
        start: Place of the bitmap's first.
        rows: Of the bitmap.
        columns: Of the bitmap.
        i: Column.
        j: Row.
    """
    column, row = np.floor(i), np.floor(j)
    across, down = cubic_weights_of_look_loop(np.float32(i - column)), cubic_weights_of_look_loop(np.float32(j - row))
    first, top = _clamped(column, columns) - 1, _clamped(row, rows) - 1
    c0 = c1 = c2 = c3 = np.float32(0)
    for b in range(4):
        line = start + 4 * columns * min(max(top + b, 0), rows - 1)
        for a in range(4):
            weight = across[a] * down[b]
            place = line + 4 * min(max(first + a, 0), columns - 1)
            c0 += weight * samples[place]
            c1 += weight * samples[place + 1]
            c2 += weight * samples[place + 2]
            c3 += weight * samples[place + 3]
    return c0, c1, c2, c3


@inlined
def linear_of_look_loop(samples: Reals, start: int, rows: int, columns: int, i: float, j: float) -> Quadruple:
    """Four channels at a point of a bitmap of two rows and columns at least; arguments as for `cubic`."""
    i, j = min(max(i, 0.0), columns - 1.0), min(max(j, 0.0), rows - 1.0)
    column, row = min(int(i), columns - 2), min(int(j), rows - 2)
    across, down = samples.dtype.type(i - column), samples.dtype.type(j - row)
    one = samples.dtype.type(1)
    w11 = across * down
    w10, w01 = down - w11, across - w11
    w00 = one - across - w10
    a = start + 4 * (row * columns + column)
    b = a + 4 * columns
    return (
        w00 * samples[a] + w01 * samples[a + 4] + w10 * samples[b] + w11 * samples[b + 4],
        w00 * samples[a + 1] + w01 * samples[a + 5] + w10 * samples[b + 1] + w11 * samples[b + 5],
        w00 * samples[a + 2] + w01 * samples[a + 6] + w10 * samples[b + 2] + w11 * samples[b + 6],
        w00 * samples[a + 3] + w01 * samples[a + 7] + w10 * samples[b + 3] + w11 * samples[b + 7],
    )


@inlined
def cubic_weights_of_look_loop(t: np.float32) -> Quadruple:
    """Keys' weights, as in `lookups`."""
    half, squared = np.float32(0.5), t * t
    cubed = squared * t
    return (
        squared - half * (t + cubed),
        np.float32(1) - np.float32(2.5) * squared + np.float32(1.5) * cubed,
        half * t + np.float32(2) * squared - np.float32(1.5) * cubed,
        half * (cubed - squared),
    )


@inlined
def _clamped(position: float, length: int) -> int:
    return int(min(max(position, -4.0), length + 4.0))
