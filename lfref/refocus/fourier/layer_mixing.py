"""Spectra of layers mixed by a small matrix at each frequency: the arithmetic of `disparity_layers`.

A layer at disparity d, behind weights w_uv with the focus at s, is multiplied at each frequency by the transform
of the aperture, and, where each view stands for a cell p = `fill_factor` view steps wide, by that of the cell; with
e = s - d:

    D(e) = sum_uv w_uv exp(2 pi i e ((u - u0) kx + (v - v0) ky)),   c(e) = sinc(p e kx) sinc(p e ky).

For U x V equal weights and p = 1 the product is the transform of the whole square, sinc(U e kx) sinc(V e ky).
The matrices are sums of few products of a row factor and a column factor and are formed frequency by frequency: written
out they would exceed the views.
`disparity_layers` says what is solved; this file says how, and knows no light fields.
Letters: `u v` view column and row, `kx ky` frequency in cycles per pixel, `h w` numbers of rows and columns of
frequencies, `m n` spectra, `T` terms of the matrices, `b c` batch and channel.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import chosen
from lfref.functional import fourier, positive_definite
from lfref.functional.devices import on_device
from lfref.functional.fourier import Frame

SPARE = 2
"""Pixels of a period beyond the reach of shifts, for the support of interpolation and blur."""


class Matrices(NamedTuple):
    """A matrix at each frequency (y, x): `sum_t rows[..., t, y] columns[..., t, x]`; both real or both complex."""

    rows: Tensor
    """Float64 or complex128, [m, n, T, h]."""
    columns: Tensor
    """Float64 or complex128, [m, n, T, w]."""

    def times(self, other: "Matrices") -> "Matrices":
        """The product, element by element: each term of one with each term of the other."""
        return Matrices(
            (self.rows[..., :, None, :] * other.rows[..., None, :, :]).flatten(-3, -2),
            (self.columns[..., :, None, :] * other.columns[..., None, :, :]).flatten(-3, -2),
        )

    def minus(self, other: "Matrices") -> "Matrices":
        """The difference: the terms of both, one row factor negated."""
        return Matrices(torch.cat([self.rows, -other.rows], -2), torch.cat([self.columns, other.columns], -2))


def aperture_response(distances: Tensor, aperture: Tensor, size: tuple[int, int]) -> Matrices:
    """D at each distance s - d [m, n] for pictures of a size (H, W): real where opposite views weigh the same."""
    # The singular value decomposition writes the weights as few products of a row and a column (one for a square),
    # so that D becomes few products of sums over the rows and sums over the columns.
    negligible = 1e-12  # of singular values: float64 cannot tell it from 0
    left, strength, right = torch.linalg.svd(aperture, full_matrices=False)
    rank = int((strength > negligible * strength[0]).sum())
    terms = left[:, :rank] * strength[:rank], right[:rank].T
    device = distances.device
    (down, down_sines), (across, across_sines) = (
        _sums(distances, on_device(weights, device), frequencies)
        for frequencies, weights in zip(
            (fourier.frequencies(size[0], device), fourier.half_frequencies(size[1], device)), terms, strict=True
        )
    )
    if not torch.allclose(aperture, aperture.flip(0, 1), rtol=negligible, atol=0):
        return Matrices(torch.complex(down, down_sines), torch.complex(across, across_sines))
    # The imaginary part of the product cancels; its real part is the product of both cosines less that of both sines.
    # Rows and columns that are symmetric themselves have no sines.
    has_sines = [
        n for n in range(rank) if not all(torch.allclose(part[:, n], part[:, n].flip(0), atol=1e-9) for part in terms)
    ]
    rows = torch.cat([down, -down_sines[..., has_sines, :]], -2)
    return Matrices(rows, torch.cat([across, across_sines[..., has_sines, :]], -2))


def _sums(distances: Tensor, weights: Tensor, frequencies: Tensor) -> Tensor:
    """Cosines and sines of light at distances [m, n], summed over views by weights [V, T]: [2, m, n, T, K]."""
    turns = distances[..., None] * geometry.angular_offsets(len(weights), distances.device)
    return weights.T @ fourier.waves(turns[..., None] * frequencies)


def cell_response(distances: Tensor, fill_factor: float, size: tuple[int, int]) -> Matrices:
    """c at each distance [m, n], for cells `fill_factor` view steps wide; otherwise as `aperture_response`."""
    device = distances.device
    frequencies = fourier.frequencies(size[0], device), fourier.half_frequencies(size[1], device)
    return Matrices(*(torch.sinc(fill_factor * distances[..., None, None] * k) for k in frequencies))


def make_frame(border: str, size: tuple[int, int], reaches: tuple[float, float]) -> Frame:
    """The frame of pictures of a size (H, W); where the border is `edge`, with room for shifts down and across by so
    many pixels."""
    if not chosen("border", border, {"edge": True, "wrap": False}):
        return Frame(size, (0, 0), size)
    if torch.compiler.is_exporting():  # a file transforms any length at the same speed
        down, across = reaches[0] + SPARE, reaches[1] + SPARE  # whole numbers, which `int` would read
        return Frame(size, (down, across), (size[0] + 2 * down, size[1] + 2 * across))  # type: ignore[arg-type]
    height, width = (
        fourier.next_fast(length + 2 * (int(reach) + SPARE)) for length, reach in zip(size, reaches, strict=True)
    )
    return Frame(size, ((height - size[0]) // 2, (width - size[1]) // 2), (height, width))


def multiply(spectra: Tensor, matrices: Matrices) -> Tensor:
    """The matrices [m, n] times complex spectra [B, n, C, h, w]: complex, [B, m, C, h, w]."""
    return _at_all(spectra, matrices, torch.matmul)


def solve(spectra: Tensor, matrices: Matrices, diagonal: Tensor) -> Tensor:
    """Spectra x, [B, n, C, h, w], for which (matrices + diagonal) x are the given ones; sums are positive definite."""

    def step(small: Tensor, numbers: Tensor) -> Tensor:
        return torch.cholesky_solve(numbers, positive_definite.cholesky(small + torch.diag(diagonal).to(small)))

    return _at_all(spectra, matrices, step)


def _at_all(spectra: Tensor, matrices: Matrices, step: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
    """A step of matrices [F, m, n] and numbers [F, n, C] at all frequencies, one band of rows after the other."""
    dtype = spectra.dtype if matrices.rows.is_complex() else spectra.real.dtype
    rows, columns = (factors.to(spectra.device, dtype) for factors in matrices)
    height = max(1, (1 << 13) // columns.shape[-1])  # so many frequencies that their matrices stay in the cache
    bands = []
    for part, factors in zip(spectra.split(height, dim=-2), rows.split(height, dim=-1), strict=True):
        batch, _, channels, *size = part.shape
        numbers = part.permute(3, 4, 1, 0, 2).reshape(size[0] * size[1], -1, batch * channels)
        small = (factors.mT @ columns).flatten(2).permute(2, 0, 1)
        if small.is_complex():
            mixed = step(small, numbers)
        else:  # both parts as channels: real matrices take half the time
            mixed = torch.complex(*step(small, torch.cat([numbers.real, numbers.imag], -1)).chunk(2, -1))
        bands.append(mixed.reshape(*size, -1, batch, channels).permute(3, 2, 4, 0, 1))
    return torch.cat(bands, dim=-2)
