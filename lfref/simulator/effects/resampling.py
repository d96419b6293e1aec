"""Reading pictures between their samples at positions that separate into rows and columns.

Lagrange interpolation through eight samples: it reproduces polynomials of degree 7, and the samples themselves at whole
positions. Beyond the edge the outermost sample is held. Source: Laakso et al., "Splitting the unit delay", 1996.
"""

import math

import torch
from torch import Tensor

TAPS = range(-3, 5)  # samples around a position, counted from the one at or before it


def weights(t: Tensor) -> Tensor:
    """How much each of the samples `TAPS` counts.

    Args:
        t: Positions from the sample at or before them, in [0, 1), [...].

    Returns:
        Weights of sum 1, [..., 8].
    """
    return torch.stack(
        [
            math.prod(((t - other) / (tap - other) for other in TAPS if other != tap), start=torch.ones_like(t))
            for tap in TAPS
        ],
        -1,
    )


def matrix(positions: Tensor, length: int) -> Tensor:
    """The resampling of one axis as a matrix.

    Args:
        positions: Where to read, in pixels from the centre, float64, [..., K].
        length: Samples along the axis.

    Returns:
        Weight of every sample at every position, float64, [..., K, length].
    """
    index = (positions + (length - 1) / 2).clamp(0, length - 1)
    whole = index.floor()
    taps = whole.long()[..., None] + torch.tensor(TAPS)
    empty = torch.zeros(*positions.shape, length, dtype=positions.dtype)
    return empty.scatter_add_(-1, taps.clamp(0, length - 1), weights(index - whole))


def resample(views: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Read pictures at other rows and columns.

    Args:
        views: Floating point, [V, U, C, H, W].
        rows: Where to read, in pixels from the centre, float64, CPU, [H] with leading axes that go with [V, U, C].
        columns: Likewise, [..., W].

    Returns:
        Pictures of the same shape.
    """
    height, width = views.shape[-2:]
    return matrix(rows, height).to(views) @ views @ matrix(columns, width).to(views).mT
