"""Fourier transforms: fast lengths, frequencies, shifts as phases; and transforms as matrix products, for files.

Files hold no complex numbers, and runtimes transform slowly (ONNX's DFT took 13 times as long as the products at 540
samples, and rounded 14 times as coarsely). So factors of frequencies are a pair of real tensors, real and imaginary
parts stacked, [2, ...], from which code for PyTorch makes complex numbers.
Phases are computed in float64, whatever the data are: at 500 pixels float32 phases cost three digits.
Letters: `k` frequency in cycles per sample, `K` numbers of frequencies, `h w` rows and columns of a period.
"""

import itertools
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.functional.devices import is_known, number


def is_fast(length: int) -> bool:
    """Whether FFTs are fast at a length, at least 1: a product of 2, 3 and 5."""
    return pow(30, length.bit_length(), length) == 0


def next_fast(least: int) -> int:
    """The smallest length, at least `least`, at which FFTs are fast."""
    return next(filter(is_fast, itertools.count(max(least, 1))))


def next_fast_even(least: int) -> int:
    """The smallest even length, at least `least`, at which FFTs are fast."""
    return 2 * next_fast(-(-least // 2))


def half_frequencies(length: int, device: torch.device | None = None) -> Tensor:
    """Frequencies of `rfft` in cycles per sample, float64, [length // 2 + 1]."""
    k = torch.arange(length // 2 + 1, dtype=torch.float64, device=device)
    return k / number(length, k)


def frequencies(length: int, device: torch.device | None = None) -> Tensor:
    """Frequencies of `fft` in cycles per sample, float64, [length]."""
    k = torch.arange(length, dtype=torch.float64, device=device)
    return torch.where(k >= (length + 1) // 2, k - length, k) / number(length, k)


def complex_dtype(dtype: torch.dtype) -> torch.dtype:
    """The complex type that goes with a real one: complex128 for float64, complex64 for all others."""
    return torch.complex128 if dtype == torch.float64 else torch.complex64


def waves(turns: Tensor) -> Tensor:
    """Cosines and sines of angles in turns, [2, ...]."""
    angles = 2 * torch.pi * turns
    return torch.stack([angles.cos(), angles.sin()])


def waves_of_period(places: Tensor, period: int) -> Tensor:
    """Cosines and sines at whole places of any distance, [2, ...], which repeat after a period."""
    one = waves(torch.arange(period, dtype=torch.float64, device=places.device) / number(period, places))
    return one.index_select(1, wrapped(places, period).reshape(-1)).reshape(2, *places.shape)


def transformed(taps: Tensor, period: int, is_half: bool) -> Tensor:
    """What filters by taps [..., T] do to the frequencies of a period, [2, ..., K]: those of `rfft`, or all.

    The taps read pixels at x - T / 2, ..., x + T / 2 - 1.
    """
    place = torch.arange(taps.shape[-1], device=taps.device) - taps.shape[-1] // 2
    k = torch.arange(period // 2 + 1 if is_half else period, device=taps.device)
    return taps @ waves_of_period(place[:, None] * k, period)[:, *[None] * (taps.ndim - 2)]


def shift_phases(frequencies: Tensor, shifts: Tensor) -> Tensor:
    """Factors exp(2 pi i shift k), [2, ..., K], from the spectrum of f(x) to that of f(x + shift).

    The Nyquist bin belongs to both signs of its frequency: its factor is their mean, which is real.
    """
    real, imaginary = waves(shifts[..., None] * frequencies)
    return torch.stack([real, torch.where(frequencies.abs() == 0.5, 0.0, imaginary)])


def real_at_nyquist(factors: Tensor, frequencies: Tensor) -> Tensor:
    """Complex factors [..., K] at frequencies [K] as [2, ..., K], real at the Nyquist frequency."""
    return torch.stack([factors.real, torch.where(frequencies.abs() == 0.5, 0.0, factors.imag)])


def at_bins(images: Tensor, y: Tensor, x: Tensor) -> Tensor:
    """The transforms of images [..., h, w] at rows y, which may be negative, and columns x of `rfft2`, [2, ..., F]."""
    height, width = images.shape[-2:]
    if not torch.compiler.is_exporting():
        spectra = torch.fft.rfft2(images)[..., y.remainder(height), x]
        return torch.stack([spectra.real, spectra.imag])
    down, across = (
        waves(wrapped(torch.arange(length)[:, None] * bins, length) / number(length, images)).to(images)
        for length, bins in ((height, y), (width, x))
    )
    # The mean is at none of the bins, and would be the largest number to round.
    real, imaginary = ((images - images.mean()) @ torch.cat([across[0], -across[1]], 1)).split(x.shape[0], -1)
    return torch.stack([(real * down[0] + imaginary * down[1]).sum(-2), (imaginary * down[0] - real * down[1]).sum(-2)])


def wrapped(places: Tensor, length: int) -> Tensor:
    """Integers modulo a length."""
    return places.remainder(torch.full((), length, dtype=places.dtype, device=places.device))


class Frame(NamedTuple):
    """Where a picture lies in one period of a periodic one: the room around it keeps opposite borders apart."""

    size: tuple[int, int]
    """Height and width (H, W) of the picture."""
    first: tuple[int, int]
    """Row and column of its first pixel in the period."""
    period: tuple[int, int]
    """Height and width (h, w) of the period."""

    def extended(self, pictures: Tensor) -> Tensor:
        """Periods [..., h, w] that hold pictures [..., H, W], the outermost pixels repeated around them."""
        if self.period == self.size:
            return pictures
        (top, left), (height, width) = self.first, self.period
        sides = (left, width - left - self.size[1], top, height - top - self.size[0])
        padded = F.pad(pictures.reshape(1, -1, *pictures.shape[-2:]), sides, mode="replicate")
        return padded.reshape(*pictures.shape[:-2], height, width)

    def within(self, periods: Tensor) -> Tensor:
        """The pictures [..., H, W] in periods [..., h, w]."""
        (top, left), (height, width) = self.first, self.size
        return periods.narrow(-2, top, height).narrow(-1, left, width)

    def pictures(self, spectra: Tensor) -> Tensor:
        """Pictures [..., H, W] in the periods with these spectra [..., h, w // 2 + 1]."""
        return self.within(torch.fft.irfft2(spectra, s=self.period))


Factors = Sequence[tuple[Tensor, Tensor]]
"""Filters of each line, real and imaginary parts: of its rows, [2, N, h], and its columns, [2, N, U, w // 2 + 1]."""


def filtered_lines(lines: Iterable[Tensor], factors: Factors, frame: Frame) -> Tensor:
    """Sums [N, P, H, W] of filtered pictures, line by line [U, P, H, W], each in a period."""
    if torch.compiler.is_exporting():
        return frame.within(_filtered_by_matrices(lines, factors, frame))
    spectra = mixed_lines(lines, factors, frame)
    if len(spectra) == 1:
        return frame.pictures(spectra[0])
    # Each spectrum is given up as its image is written: all of both together would be the peak of memory.
    stack = spectra[0].real.new_empty((len(spectra), spectra[0].shape[1], *frame.size))
    for n in reversed(range(len(spectra))):
        stack[n] = frame.pictures(spectra.pop()[0])
    return stack


def mixed_lines(lines: Iterable[Tensor], factors: Factors, frame: Frame) -> list[Tensor]:
    """The spectra of `filtered_lines`, in parts [n, P, h, w // 2 + 1] that are together those of all planes."""
    totals: list[Tensor] = []
    for pictures, (rows, columns) in zip(lines, factors, strict=True):
        periods = frame.extended(pictures)
        spectra, down, across = torch.fft.rfft2(periods), torch.complex(*rows)[..., None], torch.complex(*columns)
        if not is_known(pictures):
            # One product a frequency mixes the views for all planes; each operation of a GPU costs its start.
            mixed = torch.einsum("nuk,uphk->npkh", across, spectra).mT
            totals = [mixed * down[:, None] if not totals else totals[0].addcmul_(mixed, down[:, None])]
            continue
        totals = totals or [torch.zeros_like(spectra[:1]) for _ in down]
        for total, row_factors, column_factors in zip(totals, down, across, strict=True):
            part = spectra[0] * column_factors[0]
            for spectrum, factor in zip(spectra[1:], column_factors[1:], strict=True):
                part.addcmul_(spectrum, factor)
            total[0].addcmul_(part, row_factors)
            del part  # so that the next sum gets the same memory, which is in the cache
    return totals


class _Matrices(NamedTuple):
    """The transform of a real sequence as products of its even part with cosines, and of its odd part with sines.

    Each part has half of the length: together they take a quarter of the work of a product with all waves.
    """

    cosines: Tensor
    """At frequencies and samples from 0 to half of the length, [K, K]."""
    sines: Tensor
    opposite: Tensor
    """Samples -x for x from 0 to half of the length, [K]."""
    is_pair: Tensor
    """1 where x and -x are two samples, else 0, [K]."""
    place: Tensor
    """Of each sample of the sequence in the samples x, then -x, [L]."""

    def parts(self, sequences: Tensor) -> tuple[Tensor, Tensor]:
        """Sums and differences of samples x and -x of sequences [..., L], [..., K] both."""
        first = sequences.narrow(-1, 0, self.opposite.shape[0])
        last = sequences.index_select(-1, self.opposite)
        return first + self.is_pair * last, first - last

    def whole(self, even: Tensor, odd: Tensor) -> Tensor:
        """The sequences [..., L] of their even and odd parts [..., K]."""
        return torch.cat([even + odd, even - odd], -1).index_select(-1, self.place)


def _matrices(length: int, like: Tensor) -> _Matrices:
    x, samples = (torch.arange(n, device=like.device) for n in (length // 2 + 1, length))
    cosines, sines = waves_of_period(x[:, None] * x, length).to(like)
    beyond = (samples >= x.shape[0]).long()
    place = torch.minimum(samples, length - samples) + x.shape[0] * beyond
    return _Matrices(cosines, sines, wrapped(-x, length), ((x > 0) & (2 * x < length)).to(like), place)


def _filtered_by_matrices(lines: Iterable[Tensor], factors: Sequence[tuple[Tensor, Tensor]], frame: Frame) -> Tensor:
    """The periods of `filtered_lines`, [N, P, h, w], without complex numbers."""
    (height, width), like = frame.period, factors[0][0]
    along_y, along_x, level = _matrices(height, like), _matrices(width, like), like.new_zeros(())
    sums: tuple[Tensor, Tensor] | None = None
    for pictures, (rows, columns) in zip(lines, factors, strict=True):
        periods = frame.extended(pictures)
        # In the spectra, the mean would be by far the largest number, and round as such.
        mean = periods.mean()
        level = level + mean * rows[0, :, 0] * columns[0, :, :, 0].sum(1)
        even, odd = along_x.parts(periods - mean)
        real, imaginary = ((even @ along_x.cosines).mT, -(odd @ along_x.sines).mT)  # [U, P, k, h]
        (even_real, odd_real), (even_imaginary, odd_imaginary) = map(along_y.parts, (real, imaginary))
        spectra = [
            along_y.whole(even_real @ along_y.cosines, odd_imaginary @ along_y.sines),
            along_y.whole(even_imaginary @ along_y.cosines, -(odd_real @ along_y.sines)),
        ]
        n_views, n_pictures = periods.shape[:2]
        data = torch.stack(spectra).permute(3, 0, 1, 2, 4).reshape(width // 2 + 1, 2 * n_views, n_pictures * height)
        # A complex product as one of real matrices, [k, 2 N, 2 U].
        upper, lower = torch.cat([columns[0], -columns[1]], 1), torch.cat([columns[1], columns[0]], 1)
        mixed = torch.cat([upper, lower]).permute(2, 0, 1) @ data
        real, imaginary = mixed.reshape(width // 2 + 1, 2, rows.shape[1], n_pictures, height).unbind(1)
        down = rows[:, :, None]
        part = real * down[0] - imaginary * down[1], real * down[1] + imaginary * down[0]
        sums = part if sums is None else (sums[0] + part[0], sums[1] + part[1])
    assert sums is not None
    (even_real, odd_real), (even_imaginary, odd_imaginary) = map(along_y.parts, sums)
    real, imaginary = (
        along_y.whole(even_real @ along_y.cosines, -(odd_imaginary @ along_y.sines)),
        along_y.whole(even_imaginary @ along_y.cosines, odd_real @ along_y.sines),
    )
    # Each frequency between 0 and half a cycle stands for its negative too.
    share = (1 + along_x.is_pair) / (number(height, real) * number(width, real)).to(real)
    real, imaginary = (part.permute(1, 2, 3, 0) * share for part in (real, imaginary))
    return level[:, None, None, None] + along_x.whole(real @ along_x.cosines, -(imaginary @ along_x.sines))
