"""Views read at other rows and columns, each view and channel at its own.

The interpolation is that of the simulator (Lagrange, eight samples), which blurs little and keeps whole positions.
"""

import dataclasses

import torch
from torch import Tensor

from lfref import geometry
from lfref.captures import resampling_loop
from lfref.functional import threads
from lfref.lightfield import LightField
from lfref.simulator.effects import resampling

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
    lines = (starts[..., None] + torch.arange(len(resampling.TAPS))).clamp(0, height - 1)
    begins, across = _taps(columns.cpu().expand(*shape, width).flatten(0, 2), width, samples.dtype)
    tables = (samples, lines, down, begins, across.mT.contiguous(), made)
    arrays = [table.numpy() for table in tables]
    n_threads = threads.worthwhile(made.numel(), WORTH_A_THREAD)
    bands = threads.bands(len(samples), n_threads)
    threads.share(lambda first, last: resampling_loop.resample(*arrays, first, last), bands, n_threads)
    return made.reshape(views.shape).to(views.device)


def _taps(positions: Tensor, length: int, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """First sample [B, n], perhaps beyond the edge, and weights [B, n, 8] from there on, for positions [B, n]."""
    index = (positions + (length - 1) / 2).clamp(0, length - 1)
    whole = index.floor()
    return whole.long() + resampling.TAPS[0], resampling.weights(index - whole).to(dtype)


def centred(size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Rows [H] and columns [W] of pixels from the picture's centre, float64.

    Args:
        size: Height and width.
    """
    rows, columns = (geometry.angular_offsets(n) for n in size)
    return rows, columns
