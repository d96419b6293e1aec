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
from torch.nn import functional as F

from lfref import geometry
from lfref.errors import chosen
from lfref.functional import fft_lengths
from lfref.refocus.fourier import exact

SPARE = 2
"""Pixels of a period beyond the reach of shifts, for the support of interpolation and blur."""


class Matrices(NamedTuple):
    """A matrix at each frequency (y, x): `sum_t rows[..., t, y] columns[..., t, x]`; both real or both complex."""

    rows: Tensor
    """Float64 or complex128, CPU, [m, n, T, h]."""
    columns: Tensor
    """Float64 or complex128, CPU, [m, n, T, w]."""

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
    negligible = 1e-12  # of singular values and factors: float64 cannot tell it from 0
    left, strength, right = torch.linalg.svd(aperture, full_matrices=False)
    rank = int((strength > negligible * strength[0]).sum())
    sums = []
    for frequencies, weights in (
        (exact.frequencies(size[0]), left[:, :rank] * strength[:rank]),
        (exact.half_frequencies(size[1]), right[:rank].T),
    ):
        turns = distances[..., None] * geometry.angular_offsets(len(weights))
        angle = 2 * torch.pi * turns[..., None] * frequencies
        sums.append(weights.T.to(torch.complex128) @ torch.polar(torch.ones_like(angle), angle))
    down, across = sums
    if not torch.allclose(aperture, aperture.flip(0, 1), rtol=negligible, atol=0):
        return Matrices(down, across)
    # The imaginary part of the product cancels; its real part is down.real across.real - down.imag across.imag.
    rows, columns = torch.cat([down.real, -down.imag], -2), torch.cat([across.real, across.imag], -2)
    # Terms that vanish are dropped: rows and columns that are symmetric themselves have no imaginary part.
    counts = (rows.abs().amax((0, 1, 3)) > negligible) & (columns.abs().amax((0, 1, 3)) > negligible)
    return Matrices(rows[..., counts, :], columns[..., counts, :])


def cell_response(distances: Tensor, fill_factor: float, size: tuple[int, int]) -> Matrices:
    """c at each distance [m, n], for cells `fill_factor` view steps wide; otherwise as `aperture_response`."""
    frequencies = exact.frequencies(size[0]), exact.half_frequencies(size[1])
    return Matrices(*(torch.sinc(fill_factor * distances[..., None, None] * k) for k in frequencies))


class Frame(NamedTuple):
    """Where a picture lies in one period of a periodic one: the room around it keeps opposite borders apart."""

    size: tuple[int, int]
    """Height and width (H, W) of the picture."""
    first: tuple[int, int]
    """Row and column of its first pixel in the period."""
    period: tuple[int, int]
    """Height and width (h, w) of the period."""

    def extend(self, pictures: Tensor) -> Tensor:
        """Periods [..., h, w] that hold the pictures [..., H, W], the outermost pixels repeated around them."""
        if self.period == self.size:
            return pictures
        (height, width), (top, left) = self.period, self.first
        sides = (left, width - left - self.size[1], top, height - top - self.size[0])
        padded = F.pad(pictures.reshape(1, -1, *self.size), sides, mode="replicate")
        return padded.reshape(*pictures.shape[:-2], *self.period)

    def within(self, periods: Tensor) -> Tensor:
        """The pictures [..., H, W] in periods [..., h, w]."""
        (top, left), (height, width) = self.first, self.size
        return periods[..., top : top + height, left : left + width]

    def pictures(self, spectra: Tensor) -> Tensor:
        """Pictures [..., H, W] in the periods with these spectra [..., h, w // 2 + 1]."""
        return self.within(torch.fft.irfft2(spectra, s=self.period))


def make_frame(border: str, size: tuple[int, int], reach: float) -> Frame:
    """The frame of pictures of a size (H, W), with room for shifts by `reach` pixels where the border is `edge`."""
    room = chosen("border", border, {"edge": int(reach) + SPARE, "wrap": None})
    if room is None:
        return Frame(size, (0, 0), size)
    height, width = (fft_lengths.next_fast(length + 2 * room) for length in size)
    return Frame(size, ((height - size[0]) // 2, (width - size[1]) // 2), (height, width))


def multiply(spectra: Tensor, matrices: Matrices) -> Tensor:
    """The matrices [m, n] times complex spectra [B, n, C, h, w]: complex, [B, m, C, h, w]."""
    return _at_all(spectra, matrices, torch.matmul)


def solve(spectra: Tensor, matrices: Matrices, diagonal: Tensor) -> Tensor:
    """Spectra x, [B, n, C, h, w], for which (matrices + diagonal) x are the given ones; sums are positive definite."""

    def step(small: Tensor, numbers: Tensor) -> Tensor:
        return torch.cholesky_solve(numbers, torch.linalg.cholesky(small + torch.diag(diagonal).to(small)))

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
