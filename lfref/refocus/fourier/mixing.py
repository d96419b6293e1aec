"""Spectra mixed with each other: a small matrix at each frequency, which they are multiplied with or solved for.

Letters: `m n` spectra, `h w` numbers of rows and columns of frequencies, `C` channels, of all batches in one.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from lfref.functional import fourier

BAND = 1 << 13  # frequencies at a time, so that their matrices stay in the cache
Matrices = Callable[[Tensor, Tensor], Tensor]
"""Frequencies of rows [h] and columns [w] in cycles per pixel -> their matrices, real or complex, CPU, [m, n, h, w]."""
Step = Callable[[Tensor, Tensor], Tensor]
"""Matrices [F, m, n] and numbers [F, n or m, C] -> numbers, all of one type."""


def mixed(spectra: Tensor, width: int, matrices: Matrices) -> Tensor:
    """Sums of spectra, each times its element of the matrices.

    Args:
        spectra: Of pictures W pixels wide, complex, [B, n, C, H, W // 2 + 1].
        width: W.
        matrices: As above.

    Returns:
        Complex, [B, m, C, H, W // 2 + 1].
    """
    return _in_bands(spectra, width, matrices, torch.matmul)


def unmixed(spectra: Tensor, width: int, matrices: Matrices) -> Tensor:
    """Spectra that would be mixed to the ones given; the matrices are Hermitian and positive definite.

    Args:
        spectra: As in `mixed`.
        width: As in `mixed`.
        matrices: As above, m = n.
    """
    return _in_bands(spectra, width, matrices, _solution)


def _solution(matrices: Tensor, numbers: Tensor) -> Tensor:
    return torch.cholesky_solve(numbers, torch.linalg.cholesky(matrices))


def _in_bands(spectra: Tensor, width: int, matrices: Matrices, step: Step) -> Tensor:
    rows, columns = fourier.frequencies(spectra.shape[-2]), fourier.half_frequencies(width)
    height = max(1, BAND // len(columns))
    bands = zip(spectra.split(height, dim=-2), rows.split(height), strict=True)
    return torch.cat([_band(part, matrices(ky, columns), step) for part, ky in bands], dim=-2)


def _band(spectra: Tensor, matrices: Tensor, step: Step) -> Tensor:
    batch, _, channels, *size = spectra.shape
    numbers = spectra.permute(3, 4, 1, 0, 2).reshape(size[0] * size[1], -1, batch * channels)
    small = matrices.to(spectra.device).flatten(2).permute(2, 0, 1)
    if matrices.is_complex():
        made = step(small, numbers)
    else:  # both parts as channels, since real matrices take half the time
        made = torch.complex(*step(small, torch.cat([numbers.real, numbers.imag], -1)).chunk(2, -1))
    return made.reshape(*size, -1, batch, channels).permute(3, 2, 4, 0, 1)
