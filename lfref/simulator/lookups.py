"""Reading a bitmap between its samples: cubic for views, linear for the truth, by PyTorch and in compiled loops.

Cubic convolution by Keys (a = -1/2, which reproduces quadratics) is sharp, so views use it. The truth reads copies that
are blurred anyway, so linear look-ups suffice. PyTorch's forms run on any device; the compiled ones, which read one
point at a time, are for the loops on the CPU. The ends of a bitmap go on beyond it.
Letters: `h w` rows and columns of the bitmap, `i j` column and row in samples, `t` fraction of a sample, `M` pictures.
Source: Keys, "Cubic convolution interpolation for digital image processing", 1981.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.functional import splines
from lfref.functional.jit import inlined

TAPS = 4
"""Samples along an axis that a cubic reads: at -1, 0, 1 and 2 from the one at or before the position."""

Floats = NDArray[np.floating]
Quadruple = tuple[np.floating, np.floating, np.floating, np.floating]
"""Weights of four samples, or red, green, blue and opacity."""


def cubic_weights(t: Tensor) -> Tensor:
    """Keys' weights of four samples for fractions [...], [..., 4]."""
    return torch.stack(splines.weights(t), dim=-1)


def _taps(position: Tensor, length: int) -> tuple[Tensor, Tensor]:
    """Four samples along an axis for each position, int64, [..., 4], and their weights, float32."""
    whole = position.floor()
    weights = cubic_weights((position - whole).float())
    # Clamped before the conversion: positions far outside may exceed int64.
    first = whole.clamp(-TAPS, length + TAPS).long() - 1
    offsets = torch.arange(TAPS, device=position.device)
    return (first[..., None] + offsets).clamp(0, length - 1), weights


def cubic_at(bitmap: Tensor, i: Tensor, j: Tensor) -> Tensor:
    """A bitmap [C, h, w] at any positions, [M, H, W] each, float64; result [M, C, H, W]."""
    n_channels, height, width = bitmap.shape
    samples = bitmap.movedim(0, -1).reshape(-1, n_channels)
    columns, across = _taps(i, width)
    rows, down = _taps(j, height)
    result = samples.new_zeros(*i.shape, n_channels)
    for row in range(TAPS):
        line = torch.zeros_like(result)
        for column in range(TAPS):
            line += samples[rows[..., row] * width + columns[..., column]] * across[..., column, None]
        result += line * down[..., row, None]
    return result.movedim(-1, -3)


def cubic_on_grid(bitmap: Tensor, i: Tensor, j: Tensor) -> Tensor:
    """A bitmap [C, h, w] on grids of columns [M, 1, W] and rows [M, H, 1], axis by axis; result [M, C, H, W]."""
    rows, down = _taps(j[..., 0], bitmap.shape[-2])
    columns, across = _taps(i[:, 0], bitmap.shape[-1])
    lines = torch.zeros((), device=bitmap.device)
    for tap in range(TAPS):
        lines = lines + bitmap[:, rows[..., tap]] * down[..., tap, None]
    shape = (*lines.shape[:-1], columns.shape[1])
    result = torch.zeros((), device=bitmap.device)
    for tap in range(TAPS):
        result = result + lines.gather(-1, columns[:, None, :, tap].expand(shape)) * across[:, None, :, tap]
    return result.movedim(0, 1)


def linear_at(bitmap: Tensor, i: Tensor, j: Tensor) -> Tensor:
    """A bitmap [C, h, w] at any positions, [M, H, W] each, read linearly; result [M, C, H, W]."""
    n_channels, height, width = bitmap.shape
    samples = bitmap.movedim(0, -1).reshape(-1, n_channels)
    i, j = i.clamp(0, width - 1), j.clamp(0, height - 1)
    column, row = i.long().clamp(max=width - 2), j.long().clamp(max=height - 2)
    across, down = ((at - whole).to(samples)[..., None] for at, whole in ((i, column), (j, row)))
    first = row * width + column
    upper = torch.lerp(samples[first], samples[first + 1], across)
    lower = torch.lerp(samples[first + width], samples[first + width + 1], across)
    return torch.lerp(upper, lower, down).movedim(-1, -3)


def clip_premultiplied(rgba: Tensor) -> Tensor:
    """Premultiplied RGBA [..., 4, H, W] without the overshoot of a cubic: no colour below 0, opacity at most 1.

    Where opacity exceeds 1, colours are scaled down with it, so that edges of a surface do not shine.
    """
    alpha = rgba.narrow(-3, 3, 1)
    return torch.where(alpha > 0, rgba.clamp(min=0) / alpha.clamp(min=1), 0)


@inlined
def cubic_sample(samples: Floats, start: int, rows: int, columns: int, i: float, j: float) -> Quadruple:
    """Four channels at column i and row j of a bitmap of `rows` x `columns` samples, whose first value is at `start`.

    `samples` holds bitmaps one after the other, the channels of a sample side by side.
    """
    column, row = np.floor(i), np.floor(j)
    across, down = _cubic_weights_of_one(np.float32(i - column)), _cubic_weights_of_one(np.float32(j - row))
    # Positions far outside are clamped while they are floats: an int would overflow.
    first, top = int(min(max(column, -4.0), columns + 4.0)) - 1, int(min(max(row, -4.0), rows + 4.0)) - 1
    c0 = c1 = c2 = c3 = np.float32(0)
    for b in range(4):
        line = start + 4 * columns * min(max(top + b, 0), rows - 1)
        for a in range(4):
            weight = across[a] * down[b]
            at = line + 4 * min(max(first + a, 0), columns - 1)
            c0 += weight * samples[at]
            c1 += weight * samples[at + 1]
            c2 += weight * samples[at + 2]
            c3 += weight * samples[at + 3]
    return c0, c1, c2, c3


@inlined
def _cubic_weights_of_one(t: np.float32) -> Quadruple:
    """`cubic_weights` of one fraction; every constant is float32, or Numba would compute in float64."""
    half, squared = np.float32(0.5), t * t
    cubed = squared * t
    return (
        squared - half * (t + cubed),
        np.float32(1) - np.float32(2.5) * squared + np.float32(1.5) * cubed,
        half * t + np.float32(2) * squared - np.float32(1.5) * cubed,
        half * (cubed - squared),
    )


@inlined
def linear_sample(samples: Floats, start: int, rows: int, columns: int, i: float, j: float) -> Quadruple:
    """Four channels of a bitmap of at least 2 x 2 samples at one point, linearly; arguments as for `cubic_sample`."""
    i, j = min(max(i, 0.0), columns - 1.0), min(max(j, 0.0), rows - 1.0)
    column, row = min(int(i), columns - 2), min(int(j), rows - 2)
    across, down = samples.dtype.type(i - column), samples.dtype.type(j - row)
    one = samples.dtype.type(1)
    w11 = across * down
    w10, w01 = down - w11, across - w11
    w00 = one - across - w10
    # a and b: first value of the upper and the lower left sample. Written out: the compiler vectorises this form.
    a = start + 4 * (row * columns + column)
    b = a + 4 * columns
    return (
        w00 * samples[a] + w01 * samples[a + 4] + w10 * samples[b] + w11 * samples[b + 4],
        w00 * samples[a + 1] + w01 * samples[a + 5] + w10 * samples[b + 1] + w11 * samples[b + 5],
        w00 * samples[a + 2] + w01 * samples[a + 6] + w10 * samples[b + 2] + w11 * samples[b + 6],
        w00 * samples[a + 3] + w01 * samples[a + 7] + w10 * samples[b + 3] + w11 * samples[b + 7],
    )
