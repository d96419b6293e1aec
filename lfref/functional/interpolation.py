"""Pictures read between their samples by Lagrange's polynomials through eight samples.

They blur little: polynomials of degree 7 are exact, and so are samples at whole positions. Beyond the edge, the
outermost sample repeats.
Source: Laakso et al., "Splitting the unit delay", 1996.
Letters: `V U` view rows and columns, `C` channels, `K` positions along an axis of `n` samples.
"""

import math

import torch
from torch import Tensor

TAPS = range(-3, 5)
"""Samples around a position, counted from the sample at or before it."""


def weights(t: Tensor) -> Tensor:
    """Lagrange's weights of the samples `TAPS`, [..., 8], for fractions t of a sample in [0, 1), [...]."""
    one = torch.ones_like(t)
    products = [math.prod(((t - other) / (tap - other) for other in TAPS if other != tap), start=one) for tap in TAPS]
    return torch.stack(products, -1)


def resample(views: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Views read at other rows and columns, each view and channel at its own.

    Args:
        views: Floating point, [V, U, C, H, W].
        rows: Rows to read, in pixels from the centre, float64, [V, U, C, H], or 1 in place of V, U, C.
        columns: Columns to read, likewise, [..., W].
    """
    leading, images = views.shape[:3], views.flatten(0, 2)
    lines, line_weights = _taps(rows.expand(*leading, -1).flatten(0, 2), views, -2)
    across, across_weights = _taps(columns.expand(*leading, -1).flatten(0, 2), views, -1)
    read = [
        _read(_read(image, lines[k], line_weights[k]).mT.contiguous(), across[k], across_weights[k]).mT
        for k, image in enumerate(images)
    ]
    return torch.stack(read).unflatten(0, leading)


def _taps(positions: Tensor, views: Tensor, axis: int) -> tuple[Tensor, Tensor]:
    """Samples along an axis that positions [B, K] read, and their weights, [B, K, 8] each."""
    n = views.shape[axis]
    index = (positions + (n - 1) / 2).clamp(0, n - 1)
    whole = index.floor()
    samples = (whole.long()[..., None] + torch.tensor(TAPS, device=index.device)).clamp(0, n - 1)
    return samples.to(views.device), weights(index - whole).to(views)


def _read(image: Tensor, samples: Tensor, weight: Tensor) -> Tensor:
    """Weighted sums of rows of an image [n, W]: [K, W]."""
    return (weight[:, None] @ image[samples])[:, 0]
