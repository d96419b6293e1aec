"""Filtering views in overlapping squares, so that filters of limited reach serve pictures of any size.

Letters: `P` what is made of the views, `T` square.
"""

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.functional import threads
from lfref.refocus import backend
from lfref.refocus.wiener import sum_loop
from lfref.refocus.wiener.filters import Pairs
from lfref.refocus.wiener.sum_loop import LANES

WORTH_A_THREAD = 1 << 18
"""Values of a band's spectra from which one more thread saves more than it costs."""


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
    given = spectra.transpose(0, 1)
    shape = (*given.shape[1:4], *given.shape[4:])
    add = _by_loop if backend.compiler_for(spectra, factors) == "numba" else _by_torch
    made = add(given.reshape(len(given), -1, *given.shape[4:]), factors, len(pairs.first))
    return made.unflatten(1, shape[:3]).transpose(0, 1)


def _by_loop(spectra: Tensor, factors: Tensor, n_sums: int) -> Tensor:
    """Spectra [V U, J, side, K] added up, [N, J, side, K]."""
    given = torch.view_as_real(spectra.resolve_conj().contiguous()).numpy()
    made = np.empty((len(factors), *given.shape[1:]), given.dtype)
    table = F.pad(factors, (0, -factors.shape[-1] % LANES)).unflatten(-1, (-1, LANES)).permute(0, 2, 3, 1, 4)
    n_threads = threads.worthwhile(made.size, WORTH_A_THREAD)
    jobs = (
        (given, table.contiguous().numpy(), n_sums, *band, made) for band in threads.bands(given.shape[2], n_threads)
    )
    threads.share(sum_loop.add_rows, jobs, n_threads)
    return torch.view_as_complex(torch.from_numpy(made))


def _by_torch(spectra: Tensor, factors: Tensor, n_sums: int) -> Tensor:
    """The same for whatever needs derivatives, and on a GPU."""
    parts = []
    for place, count in ((0, n_sums), (n_sums, len(spectra) - n_sums)):
        data = torch.view_as_real(spectra[place : place + count]).permute(2, 3, 0, 1, 4)
        weights = factors[:, place : place + count].permute(2, 3, 0, 1)
        parts.append(torch.matmul(weights, data.flatten(3)).unflatten(3, (-1, 2)))
    sums, differences = parts
    real, imaginary = sums[..., 0] - differences[..., 1], sums[..., 1] + differences[..., 0]
    return torch.complex(real, imaginary).permute(2, 3, 0, 1)
