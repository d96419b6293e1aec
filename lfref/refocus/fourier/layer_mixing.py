"""What an aperture makes of a layer out of focus: the transform of its weights, and of the area of one view's cell.

A layer of disparity d, seen through weights `w_uv` and focused at s, is multiplied at each frequency by
`D(e) = sum_uv w_uv exp(2 pi i e ((u - u0) kx + (v - v0) ky))`, e = s - d, and, where each view stands for a cell `fill`
view steps wide, by `c(e) = sinc(fill e kx) sinc(fill e ky)`. For U x V equal weights and fill 1 both together are the
transform of the whole square, `sinc(U e kx) sinc(V e ky)`.
Letters: `u v` view column and row, `kx ky` frequency in cycles per pixel, `h w` numbers of rows and columns of them.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.errors import InputError, chosen
from lfref.functional import fourier, jit, threads
from lfref.refocus import batches

# PART mixing_loop
# Loops, compiled by Numba, that multiply spectra with a matrix at each frequency, or solve for them.
#
# `LANES` frequencies of a row go through every step together, so that each step is one machine instruction for many.
# Letters: `m n` spectra, `T` terms of the matrices, `h w` rows and columns of frequencies, `b c` batch and channel.
# Complex numbers are pairs along the last axis, since matrices are real. Columns of the matrices are padded to `LANES`.

LANES = 16


@jit.compiled
def multiply_rows(
    spectra: NDArray, rows: NDArray, columns: NDArray, first: int, last: int, made: NDArray
) -> None:  # pragma: no cover - compiled
    """Multiply rows `first` to `last`.

    Args:
        spectra: [B, n, C, h, w, 2].
        rows: [m, n, T, h].
        columns: [m, n, T, w padded].
        first: Row of frequencies.
        last: One past the last one.
        made: Written to, [B, m, C, h, w, 2].
    """
    n_made, n_given, n_terms = rows.shape[:3]
    width = spectra.shape[4]
    matrix = np.empty((n_made, n_given, LANES), spectra.dtype)
    given = np.empty((n_given, LANES), spectra.dtype)
    total = np.empty(LANES, spectra.dtype)
    for y in range(first, last):
        for x in range(0, width, LANES):
            for i in range(n_made):
                for j in range(n_given):
                    _matrix(matrix[i, j], rows[i, j, :, y], columns[i, j, :, x : x + LANES], n_terms)
            for b in range(spectra.shape[0]):
                for c in range(spectra.shape[2]):
                    for part in range(2):
                        for j in range(n_given):
                            for lane in range(min(LANES, width - x)):
                                given[j, lane] = spectra[b, j, c, y, x + lane, part]
                        for i in range(n_made):
                            total[:] = 0
                            for j in range(n_given):
                                for lane in range(LANES):
                                    total[lane] += matrix[i, j, lane] * given[j, lane]
                            for lane in range(min(LANES, width - x)):
                                made[b, i, c, y, x + lane, part] = total[lane]


@jit.compiled
def solve_rows(
    spectra: NDArray, rows: NDArray, columns: NDArray, diagonal: NDArray, first: int, last: int, made: NDArray
) -> None:  # pragma: no cover - compiled
    """Solve for rows `first` to `last`, by Cholesky's factors.

    Args:
        spectra: [B, n, C, h, w, 2].
        rows: [n, n, T, h].
        columns: [n, n, T, w padded].
        diagonal: Added to that of the matrices, [n].
        first: Row of frequencies.
        last: One past the last one.
        made: Written to, [B, n, C, h, w, 2].
    """
    n, n_terms, width = rows.shape[0], rows.shape[2], spectra.shape[4]
    factor = np.empty((n, n, LANES), spectra.dtype)
    numbers = np.zeros((n, LANES), spectra.dtype)
    for y in range(first, last):
        for x in range(0, width, LANES):
            for i in range(n):
                for j in range(i + 1):
                    _matrix(factor[i, j], rows[i, j, :, y], columns[i, j, :, x : x + LANES], n_terms)
                factor[i, i] += diagonal[i]
            _factorise(factor)
            for b in range(spectra.shape[0]):
                for c in range(spectra.shape[2]):
                    for part in range(2):
                        for i in range(n):
                            for lane in range(min(LANES, width - x)):
                                numbers[i, lane] = spectra[b, i, c, y, x + lane, part]
                        _substitute(factor, numbers)
                        for i in range(n):
                            for lane in range(min(LANES, width - x)):
                                made[b, i, c, y, x + lane, part] = numbers[i, lane]


@jit.inlined
def _matrix(element: NDArray, rows: NDArray, columns: NDArray, n_terms: int) -> None:  # pragma: no cover - compiled
    """One element of the matrices, the sum of its terms, [LANES]."""
    for lane in range(LANES):
        element[lane] = rows[0] * columns[0, lane]
    for t in range(1, n_terms):
        for lane in range(LANES):
            element[lane] += rows[t] * columns[t, lane]


@jit.inlined
def _factorise(factor: NDArray) -> None:  # pragma: no cover - compiled
    """Lower triangles, [n, n, LANES], to Cholesky's factors; on the diagonal one over them."""
    n = factor.shape[0]
    for j in range(n):
        for i in range(j, n):
            for k in range(j):
                for lane in range(LANES):
                    factor[i, j, lane] -= factor[i, k, lane] * factor[j, k, lane]
        for lane in range(LANES):
            factor[j, j, lane] = 1 / np.sqrt(factor[j, j, lane])
        for i in range(j + 1, n):
            for lane in range(LANES):
                factor[i, j, lane] *= factor[j, j, lane]


@jit.inlined
def _substitute(factor: NDArray, numbers: NDArray) -> None:  # pragma: no cover - compiled
    """Numbers [n, LANES] to the solution, forwards and backwards through the factors."""
    n = factor.shape[0]
    for i in range(n):
        for k in range(i):
            for lane in range(LANES):
                numbers[i, lane] -= factor[i, k, lane] * numbers[k, lane]
        for lane in range(LANES):
            numbers[i, lane] *= factor[i, i, lane]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            for lane in range(LANES):
                numbers[i, lane] -= factor[k, i, lane] * numbers[k, lane]
        for lane in range(LANES):
            numbers[i, lane] *= factor[i, i, lane]


# PART mixing
# Spectra mixed with each other: a small matrix at each frequency, which they are multiplied with or solved for.
#
# The matrices are sums of few products of a factor for the row of frequencies and one for the column. On the CPU the
# work
# is done by compiled loops, with derivatives and on other devices by PyTorch.
# Letters: `m n` spectra, `T` terms, `h w` numbers of rows and columns of frequencies, `F` frequencies, `C` channels.

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
        return _by_loop(multiply_rows, spectra, matrices)
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
        return _by_loop(solve_rows, spectra, matrices, diagonal.to(spectra.real.dtype).numpy())

    def step(small: Tensor, numbers: Tensor) -> Tensor:
        return torch.cholesky_solve(numbers, torch.linalg.cholesky(small + torch.diag(diagonal).to(small)))

    return _in_bands(spectra, matrices, step)


def _is_for_loops(spectra: Tensor, matrices: Matrices) -> bool:
    return batches.compiler_for(spectra) == "numba" and not matrices.rows.is_complex()


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


# PART frames
# Pictures as a part of one period of a periodic one, with room for what shifts beyond the border.
#
# Without room opposite borders mix wherever views shift; in the room the outermost pixels go on.

SPARE = 2  # pixels beyond the reach, for what a kernel blurs


class Frame(NamedTuple):
    """Where a picture lies in its period."""

    size: tuple[int, int]
    """Height and width (H, W) of the picture."""
    first: tuple[int, int]
    """Row and column of its first pixel in the period."""
    period: tuple[int, int]
    """Height and width (h, w) of the period."""

    def extended(self, pictures: Tensor) -> Tensor:
        """Periods [..., h, w] that hold the pictures [..., H, W]."""
        if self.period == self.size:
            return pictures
        (height, width), (top, left) = self.period, self.first
        sides = (left, width - left - self.size[1], top, height - top - self.size[0])
        padded = F.pad(pictures.reshape(1, -1, *self.size), sides, mode="replicate")
        return padded.reshape(*pictures.shape[:-2], *self.period)

    def pictures(self, spectra: Tensor) -> Tensor:
        """Pictures [..., H, W] in periods with these spectra [..., h, w // 2 + 1]."""
        (top, left), (height, width) = self.first, self.size
        return torch.fft.irfft2(spectra, s=self.period)[..., top : top + height, left : left + width]


def _wrap(size: tuple[int, int], reach: float) -> Frame:
    """The picture is the period."""
    return Frame(size, (0, 0), size)


def _edge(size: tuple[int, int], reach: float) -> Frame:
    """Room for the reach at every side, as much more as makes FFTs fast."""
    height, width = (fourier.next_fast_length(length + 2 * (int(reach) + SPARE)) for length in size)
    return Frame(size, ((height - size[0]) // 2, (width - size[1]) // 2), (height, width))


BORDERS: dict[str, Callable[[tuple[int, int], float], Frame]] = {"edge": _edge, "wrap": _wrap}


def framed(border: str, size: tuple[int, int], reach: float) -> Frame:
    """The frame of pictures.

    Args:
        border: `edge`: beyond the border the outermost pixel goes on; `wrap`: the opposite border follows.
        size: Height and width (H, W).
        reach: Largest shift in pixels.

    Raises:
        InputError: Another border.
    """
    return chosen("border", border, BORDERS)(size, reach)


NEGLIGIBLE = 1e-12  # below this there is only rounding


def of_points(distances: Tensor, aperture: Tensor, size: tuple[int, int]) -> Matrices:
    """The transform D of the weights: real where opposite views weigh the same, as in most apertures.

    Args:
        distances: From each layer to each plane in focus, s - d, in pixels per view step, float64, [N, K].
        aperture: Weight of each view, float64, [V, U].
        size: Height and width (H, W) of the pictures in pixels.

    Returns:
        [N, K] at the frequencies of `rfft2`.
    """
    left, strength, right = torch.linalg.svd(aperture, full_matrices=False)
    rank = int((strength > NEGLIGIBLE * strength[0]).sum())  # 1 for products of rows and columns
    down = _sums(distances, fourier.frequencies(size[0]), left[:, :rank] * strength[:rank])
    across = _sums(distances, fourier.half_frequencies(size[1]), right[:rank].T)
    if not torch.allclose(aperture, aperture.flip(0, 1), rtol=NEGLIGIBLE, atol=0):
        return Matrices(down, across)
    rows, columns = torch.cat([down.real, -down.imag], -2), torch.cat([across.real, across.imag], -2)
    # Apertures whose rows and columns are symmetric themselves have no imaginary parts.
    counts = (rows.abs().amax((0, 1, 3)) > NEGLIGIBLE) & (columns.abs().amax((0, 1, 3)) > NEGLIGIBLE)
    return Matrices(rows[..., counts, :], columns[..., counts, :])


def of_cell(distances: Tensor, fill: float, size: tuple[int, int]) -> Matrices:
    """The transform c of one view's cell.

    Args:
        distances: As in `of_points`.
        fill: Width of the cells in view steps, >= 0.
        size: As in `of_points`.

    Returns:
        [N, K] at the frequencies of `rfft2`.
    """
    frequencies = fourier.frequencies(size[0]), fourier.half_frequencies(size[1])
    return Matrices(*(torch.sinc(fill * distances[..., None, None] * k) for k in frequencies))


def checked_fill(fill: float) -> float:
    """The width of a view's cell in view steps, once it is known to be finite and at least 0."""
    if not (math.isfinite(fill) and fill >= 0):
        raise InputError("fill must be finite and at least 0, in view steps", got=fill)
    return float(fill)


def _sums(distances: Tensor, frequencies: Tensor, weights: Tensor) -> Tensor:
    """Sums over the views of one axis, for each term of the weights [views, r], complex128, [N, K, r, frequencies]."""
    turns = distances[..., None] * geometry.angular_offsets(len(weights))
    angle = 2 * torch.pi * turns[..., None] * frequencies
    return weights.T.to(torch.complex128) @ torch.polar(torch.ones_like(angle), angle)
