"""Loops, compiled by Numba, that multiply spectra with a matrix at each frequency, or solve for them.

`LANES` frequencies of a row go through every step together, so that each step is one machine instruction for many.
Letters: `m n` spectra, `T` terms of the matrices, `h w` rows and columns of frequencies, `b c` batch and channel.
Complex numbers are pairs along the last axis, since matrices are real. Columns of the matrices are padded to `LANES`.
"""

import numpy as np
from numpy.typing import NDArray

from lfref.functional import jit

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
