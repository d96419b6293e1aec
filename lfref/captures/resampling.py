"""Views read at other rows and columns, each view and channel at its own; used to correct colours and alignment.

The interpolation is that of the simulator (Lagrange, eight samples): it blurs little and keeps samples at whole
positions. Letters: `b` picture, `y x` row and column of the result, `t` tap.
"""

import dataclasses

import numpy as np
import torch
from torch import Tensor

from lfref import geometry
from lfref.functional import loops
from lfref.lightfield import LightField
from lfref.simulator.effects import displacement


def centred(size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Rows [H] and columns [W] of pixels from the picture's centre, float64."""
    return geometry.angular_offsets(size[0]), geometry.angular_offsets(size[1])


def resample_field(field: LightField, rows: Tensor, columns: Tensor) -> LightField:
    """A light field whose views and weights are read elsewhere; arguments are those of `resample_views`."""
    weight = field.weight
    if weight is not None:
        # Weights have one channel: it is read at the mean place of the colours.
        means = (places.expand(*field.views.shape[:3], -1).mean(2, keepdim=True) for places in (rows, columns))
        weight = resample_views(weight, *means).clamp(0, 1)
    return dataclasses.replace(field, views=resample_views(field.views, rows, columns), weight=weight)


def resample_views(views: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Read views elsewhere; beyond the edge the outermost sample is repeated.

    Args:
        views: Floating point, [V, U, C, H, W].
        rows: Rows to read, in pixels from the centre, float64, [V, U, C, H], or 1 in place of V, U, C.
        columns: Columns to read, in the same form, [..., W].
    """
    height, width = views.shape[-2:]
    samples = views.detach().cpu().contiguous().flatten(0, 2)
    result = torch.empty_like(samples)
    starts, row_weights = _taps(rows.cpu().expand(*views.shape[:3], height).flatten(0, 2), height, samples.dtype)
    lines = (starts[..., None] + torch.arange(len(displacement.TAPS))).clamp(0, height - 1)
    begins, weights = _taps(columns.cpu().expand(*views.shape[:3], width).flatten(0, 2), width, samples.dtype)
    tables = (samples, lines, row_weights, begins, weights.mT.contiguous(), result)
    arrays = [table.numpy() for table in tables]
    n_threads = loops.worthwhile(result.numel(), 1 << 16)  # samples per thread, by trial
    bands = loops.bands(len(samples), n_threads)
    loops.share(lambda first, last: _resample(*arrays, first, last), bands, n_threads)
    return result.reshape(views.shape).to(views.device)


def _taps(positions: Tensor, length: int, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """First sample [B, n], perhaps beyond the edge, and weights [B, n, T] from there on, for positions [B, n]."""
    index = (positions + (length - 1) / 2).clamp(0, length - 1)
    whole = index.floor()
    return whole.long() + displacement.TAPS[0], displacement.weights(index - whole).to(dtype)


@loops.compiled
def _resample(pictures, rows, row_weights, starts, column_weights, result, first, last):  # type: ignore[no-untyped-def]
    """Fill the pictures [B, H, W] of the result from `first` to before `last`.

    Each row has T source rows and weights, [B, H, T]. Each column has the number of the first of its T source columns,
    [B, W], from -T + 1 to W - 1, and weights, [B, T, W].
    """
    height, width = result.shape[1:]
    n_taps = rows.shape[2]
    beyond = n_taps  # columns by which a line goes on beyond either edge
    line = np.empty(width + 2 * beyond, result.dtype)
    middle = line[beyond : beyond + width]
    for b in range(first, last):
        for y in range(height):
            # Interpolate a line along columns, and repeat its edges.
            line[:] = 0
            for t in range(n_taps):
                weight = row_weights[b, y, t]
                if weight != 0:
                    source = pictures[b, rows[b, y, t]]
                    for x in range(width):
                        middle[x] += weight * source[x]
            line[:beyond] = line[beyond]
            line[beyond + width :] = line[beyond + width - 1]
            # Then along rows. Columns whose source samples lie side by side are computed together, on vectors.
            into = result[b, y]
            into[:] = 0
            begin = 0
            while begin < width:
                start = starts[b, begin] - begin
                end = begin + 1
                while end < width and starts[b, end] - end == start:
                    end += 1
                run = into[begin:end]
                for t in range(n_taps):
                    # Slices begin at 0: an index that might be negative would keep the loop from running on vectors.
                    weights, first_read = column_weights[b, t, begin:end], beyond + start + t + begin
                    source = line[first_read : first_read + len(run)]
                    for x in range(len(run)):
                        run[x] += weights[x] * source[x]
                begin = end
