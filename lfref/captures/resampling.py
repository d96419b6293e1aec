"""The compiled loop that reads pictures at other rows and columns.

Letters: `b` picture, `y x` row and column made, `t` tap, `P` columns by which pictures go on beyond either edge.
"""

import dataclasses

import numpy as np
import torch
from torch import Tensor

from lfref import geometry
from lfref.functional import jit, threads
from lfref.lightfield import LightField
from lfref.simulator.effects import displacement


@jit.compiled
def resample(pictures, rows, row_weights, starts, column_weights, made, first, last):  # type: ignore[no-untyped-def]
    """Make the pictures from `first` to before `last`.

    Args:
        pictures: Samples, [B, H, W].
        rows: Rows that each made row is of, [B, H, T].
        row_weights: Their weights, [B, H, T].
        starts: First of the columns side by side that each made column is of, from -T + 1 to W - 1, [B, W].
        column_weights: Their weights, [B, T, W].
        made: What to fill, [B, H, W].
        first: Number of the first picture.
        last: Number after the last one.
    """
    height, width = made.shape[1:]
    n_taps = rows.shape[2]
    beyond = n_taps
    line = np.empty(width + 2 * beyond, made.dtype)
    middle = line[beyond : beyond + width]
    for b in range(first, last):
        for y in range(height):
            line[:] = 0
            for t in range(n_taps):
                weight = row_weights[b, y, t]
                if weight != 0:
                    source = pictures[b, rows[b, y, t]]
                    for x in range(width):
                        middle[x] += weight * source[x]
            line[:beyond] = line[beyond]
            line[beyond + width :] = line[beyond + width - 1]
            into = made[b, y]
            into[:] = 0
            begin = 0
            while begin < width:
                # Columns whose samples lie side by side are made together.
                start = starts[b, begin] - begin
                end = begin + 1
                while end < width and starts[b, end] - end == start:
                    end += 1
                run = into[begin:end]
                for t in range(n_taps):
                    # Slices begin at 0: an index that might be negative would keep the loop from going in steps.
                    weights, first_read = column_weights[b, t, begin:end], beyond + start + t + begin
                    source = line[first_read : first_read + len(run)]
                    for x in range(len(run)):
                        run[x] += weights[x] * source[x]
                begin = end


# PART resampled
# Views read at other rows and columns, each view and channel at its own.
#
# The interpolation is that of the simulator (Lagrange, eight samples), which blurs little and keeps whole positions.

WORTH_A_THREAD = 1 << 16


def moved(field: LightField, rows: Tensor, columns: Tensor) -> LightField:
    """A light field whose views, and what they count, are read elsewhere.

    Args:
        field: Any.
        rows: As of `resampled`; those of weights are the mean over channels.
        columns: Likewise.
    """
    weight = field.weight
    if weight is not None:
        shape = field.views.shape[:3]
        means = (places.expand(*shape, -1).mean(2, keepdim=True) for places in (rows, columns))
        weight = resampled(weight, *means).clamp(0, 1)
    return dataclasses.replace(field, views=resampled(field.views, rows, columns), weight=weight)


def resampled(views: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Read views elsewhere; beyond the edge the outermost sample is held.

    Args:
        views: Floating point, [V, U, C, H, W].
        rows: Where to read, in pixels from the centre, float64, [V, U, C, H], or 1 in place of V, U, C.
        columns: Likewise, [..., W].
    """
    height, width = views.shape[-2:]
    samples = views.detach().cpu().contiguous().flatten(0, 2)
    made = torch.empty_like(samples)
    shape = views.shape[:3]
    starts, down = _taps(rows.cpu().expand(*shape, height).flatten(0, 2), height, samples.dtype)
    lines = (starts[..., None] + torch.arange(len(displacement.TAPS))).clamp(0, height - 1)
    begins, across = _taps(columns.cpu().expand(*shape, width).flatten(0, 2), width, samples.dtype)
    tables = (samples, lines, down, begins, across.mT.contiguous(), made)
    arrays = [table.numpy() for table in tables]
    n_threads = threads.worthwhile(made.numel(), WORTH_A_THREAD)
    bands = threads.bands(len(samples), n_threads)
    threads.share(lambda first, last: resample(*arrays, first, last), bands, n_threads)
    return made.reshape(views.shape).to(views.device)


def _taps(positions: Tensor, length: int, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """First sample [B, n], perhaps beyond the edge, and weights [B, n, 8] from there on, for positions [B, n]."""
    index = (positions + (length - 1) / 2).clamp(0, length - 1)
    whole = index.floor()
    return whole.long() + displacement.TAPS[0], displacement.weights(index - whole).to(dtype)


def centred(size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Rows [H] and columns [W] of pixels from the picture's centre, float64.

    Args:
        size: Height and width.
    """
    rows, columns = (geometry.angular_offsets(n) for n in size)
    return rows, columns
