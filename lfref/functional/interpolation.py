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
    leading, (height, width) = views.shape[:3], views.shape[-2:]
    lines, down = _taps_of_images(rows.expand(*leading, -1), height, views)
    samples, across = _taps_of_images(columns.expand(*leading, -1), width, views)
    read = [
        _read(_read(image, lines[k], down[k]).mT.contiguous(), samples[k], across[k]).mT
        for k, image in enumerate(views.flatten(0, 2))
    ]
    return torch.stack(read).unflatten(0, leading)


def taps(positions: Tensor, length: int) -> tuple[Tensor, Tensor]:
    """Samples of an axis that positions [...] in pixels from its centre read, and their weights, [..., 8] each."""
    index = (positions + (length - 1) / 2).clamp(0, length - 1)
    whole = index.floor()
    samples = (whole.long()[..., None] + torch.tensor(TAPS, device=index.device)).clamp(0, length - 1)
    return samples, weights(index - whole)


def _taps_of_images(positions: Tensor, length: int, views: Tensor) -> tuple[Tensor, Tensor]:
    samples, weight = taps(positions.flatten(0, 2), length)
    return samples.to(views.device), weight.to(views)


def _read(image: Tensor, samples: Tensor, weight: Tensor) -> Tensor:
    """Weighted sums of rows of an image [n, W]: [K, W]."""
    return (weight[:, None] @ image[samples])[:, 0]
