"""Filtering views in overlapping squares, so that filters of limited reach serve pictures of any size.

Letters: `P` what is made of the views, `T` square.
"""

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.refocus.wiener.filters import Pairs


def filtered(views: Tensor, pairs: Pairs, factors: Tensor, margin: int) -> Tensor:
    """Sums of filtered views.

    Args:
        views: Light fields, float32 or float64, views row by row, [B, V U, C, H, W].
        pairs: Of the views.
        factors: Of what they make of the views, [N, V U, side, side // 2 + 1].
        margin: Pixels around each square that it only reads.

    Returns:
        Stacks, [B, N, C, H, W].
    """
    side, size = factors.shape[-2], views.shape[-2:]
    step = side - 2 * margin
    counts = [-(-length // step) for length in size]
    down, across = (count * step + margin - length for count, length in zip(counts, size, strict=True))
    padded = F.pad(views.flatten(0, 2), (margin, across, margin, down), mode="replicate").reshape(
        *views.shape[:3], size[0] + margin + down, -1
    )
    stack = views.new_empty(len(views), len(factors), views.shape[2], counts[0] * step, counts[1] * step)
    for row in range(counts[0]):
        # One row of squares at a time: their spectra are all that is held.
        band = pairs.mixed(padded[..., row * step : row * step + side, :])
        made = _combined(torch.fft.rfft2(band.unfold(-1, side, step).movedim(-2, -3)), factors, pairs)
        inner = torch.fft.irfft2(made, s=(side, side))[..., margin : side - margin, margin : side - margin]
        stack[..., row * step : (row + 1) * step, :] = inner.movedim(-3, -2).flatten(-2)
    return stack[..., : size[0], : size[1]].contiguous()


def _combined(spectra: Tensor, factors: Tensor, pairs: Pairs) -> Tensor:
    """Spectra [B, V U, C, T, side, K] times their factors, added up, [B, N, C, T, side, K]."""
    n_sums = len(pairs.first)
    shape = spectra.shape
    parts = []
    for place, count in ((0, n_sums), (n_sums, pairs.n_pairs)):
        data = torch.view_as_real(spectra[:, place : place + count]).permute(4, 5, 1, 0, 2, 3, 6)
        weights = factors[:, place : place + count].permute(2, 3, 0, 1)
        parts.append(torch.matmul(weights, data.flatten(3)).unflatten(3, (*shape[:1], *shape[2:4], 2)))
    sums, differences = (torch.view_as_complex(part.contiguous()) for part in parts)
    return torch.complex(sums.real - differences.imag, sums.imag + differences.real).permute(3, 2, 4, 5, 0, 1)
