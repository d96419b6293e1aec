"""The compiled loops' tables, made from positions in samples, and what decides whether they can serve.

Letters: `i j` columns and rows of a bitmap in samples, `M` pictures, `h w` rows and columns of the bitmap.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.simulator.canvases import OVERSAMPLING
from lfref.simulator.reading import look_loop, lookups, shift_loop
from lfref.simulator.reading.shift_loop import Sheet, Shifts

UNEVEN = 1e-9
"""Samples that steps between pixels may differ by."""


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


def can_serve(samples: Tensor, i: Tensor, j: Tensor) -> bool:
    """Whether positions are those of pixels, one after the other, with nothing to see beyond the bitmap.

    Args:
        samples: [C, h, w].
        i: Columns, [M, 1, W].
        j: Rows, [M, H, 1].
    """
    axes = (i[:, 0], samples.shape[-1]), (j[..., 0], samples.shape[-2])
    if not all(bool(((positions.diff(dim=-1) - OVERSAMPLING).abs() < UNEVEN).all()) for positions, _ in axes):
        return False
    is_within = all(positions.min() >= 1 and positions.max() < length - 2 for positions, length in axes)
    return is_within or not _goes_on(samples)


def _goes_on(samples: Tensor) -> bool:
    """Whether a bitmap is not black at its ends."""
    return any(bool(end.any()) for end in (samples[:, 0], samples[:, -1], samples[..., 0], samples[..., -1]))


def on_grid(samples: Tensor, i: Tensor, j: Tensor) -> Tensor:
    """As `lookups.on_grid`, for positions that `can_serve`."""
    pictures = np.zeros((len(i), len(samples), j.shape[-2], i.shape[-1]), np.float32)
    shift_loop.read(filled(samples.numpy()), shifts(i[:, 0, 0]), shifts(j[:, 0, 0]), pictures)
    return torch.from_numpy(pictures)


def anywhere(interleaved: Tensor, i: Tensor, j: Tensor) -> Tensor:
    """As `lookups.anywhere`, of a bitmap whose channels lie side by side, [h, w, 4]."""
    columns, rows = (value.reshape(-1).numpy() for value in (i, j))
    result = np.empty((4, columns.size), np.float32)
    look_loop.read_anywhere(interleaved.numpy(), columns, rows, result)
    return torch.from_numpy(result).reshape(4, *i.shape).movedim(0, 1)
