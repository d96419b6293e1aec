"""Spectra mixed with each other: a small matrix at each frequency, which they are multiplied with or solved for.

The matrices are sums of few products of a factor for the row of frequencies and one for the column. On the CPU the work
is done by compiled loops, with derivatives and on other devices by PyTorch.
Letters: `m n` spectra, `T` terms, `h w` numbers of rows and columns of frequencies, `F` frequencies, `C` channels.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.functional import threads
from lfref.refocus import backend
from lfref.refocus.fourier import mixing_loop
from lfref.refocus.fourier.mixing_loop import LANES

BAND = 1 << 13  # frequencies that PyTorch works on at a time, so that their matrices stay in the cache
WORTH_A_THREAD = 1 << 16
"""Numbers from which one more thread saves more than it costs."""
Step = Callable[[Tensor, Tensor], Tensor]
"""Matrices [F, m, n] and numbers [F, n, C] -> numbers [F, m, C], all of one type."""


class Matrices(NamedTuple):
    """At each frequency, `sum_t rows[..., t, y] columns[..., t, x]`; both real, or both complex."""

    rows: Tensor
    """Float64 or complex128, CPU, [m, n, T, h]."""
    columns: Tensor
    """Float64 or complex128, CPU, [m, n, T, w]."""

    def times(self, other: "Matrices") -> "Matrices":
        """Element by element."""
        return Matrices(
            (self.rows[..., :, None, :] * other.rows[..., None, :, :]).flatten(-3, -2),
            (self.columns[..., :, None, :] * other.columns[..., None, :, :]).flatten(-3, -2),
        )

    def minus(self, other: "Matrices") -> "Matrices":
        """The difference of both."""
        return Matrices(torch.cat([self.rows, -other.rows], -2), torch.cat([self.columns, other.columns], -2))


def multiplied(spectra: Tensor, matrices: Matrices) -> Tensor:
    """Sums of spectra, each times its element of the matrices.

    Args:
        spectra: Complex, [B, n, C, h, w].
        matrices: m x n.

    Returns:
        Complex, [B, m, C, h, w].
    """
    if _is_for_loops(spectra, matrices):
        return _by_loop(mixing_loop.multiply_rows, spectra, matrices)
    return _in_bands(spectra, matrices, torch.matmul)


def solved(spectra: Tensor, matrices: Matrices, diagonal: Tensor) -> Tensor:
    """Spectra that, mixed, would be the ones given.

    Args:
        spectra: Complex, [B, n, C, h, w].
        matrices: n x n, Hermitian, and with the diagonal positive definite.
        diagonal: Added to that of the matrices, float64, [n].

    Returns:
        Complex, [B, n, C, h, w].
    """
    if _is_for_loops(spectra, matrices):
        return _by_loop(mixing_loop.solve_rows, spectra, matrices, diagonal.to(spectra.real.dtype).numpy())

    def step(small: Tensor, numbers: Tensor) -> Tensor:
        return torch.cholesky_solve(numbers, torch.linalg.cholesky(small + torch.diag(diagonal).to(small)))

    return _in_bands(spectra, matrices, step)


def _is_for_loops(spectra: Tensor, matrices: Matrices) -> bool:
    return backend.compiler_for(spectra) == "numba" and not matrices.rows.is_complex()


def _by_loop(loop: Callable[..., None], spectra: Tensor, matrices: Matrices, *more: np.ndarray) -> Tensor:
    given = torch.view_as_real(spectra.resolve_conj().contiguous()).numpy()
    made = np.empty((given.shape[0], len(matrices.rows), *given.shape[2:]), given.dtype)
    rows = matrices.rows.numpy().astype(given.dtype)
    columns = F.pad(matrices.columns, (0, -matrices.columns.shape[-1] % LANES))
    tables = (np.ascontiguousarray(rows), columns.numpy().astype(given.dtype), *more)
    n_threads = threads.worthwhile(made.size, WORTH_A_THREAD)
    jobs = ((given, *tables, *band, made) for band in threads.bands(given.shape[3], n_threads))
    threads.share(loop, jobs, n_threads)
    return torch.view_as_complex(torch.from_numpy(made))


def _in_bands(spectra: Tensor, matrices: Matrices, step: Step) -> Tensor:
    dtype = spectra.dtype if matrices.rows.is_complex() else spectra.real.dtype
    rows, columns = (factors.to(spectra.device, dtype) for factors in matrices)
    height = max(1, BAND // columns.shape[-1])
    bands = zip(spectra.split(height, dim=-2), rows.split(height, dim=-1), strict=True)
    return torch.cat([_band(part, factors.mT @ columns, step) for part, factors in bands], dim=-2)


def _band(spectra: Tensor, matrices: Tensor, step: Step) -> Tensor:
    batch, _, channels, *size = spectra.shape
    numbers = spectra.permute(3, 4, 1, 0, 2).reshape(size[0] * size[1], -1, batch * channels)
    small = matrices.flatten(2).permute(2, 0, 1)
    if small.is_complex():
        made = step(small, numbers)
    else:  # both parts as channels, since real matrices take half the time
        made = torch.complex(*step(small, torch.cat([numbers.real, numbers.imag], -1)).chunk(2, -1))
    return made.reshape(*size, -1, batch, channels).permute(3, 2, 4, 0, 1)
