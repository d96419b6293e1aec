"""Exact sub-pixel shifts in the Fourier domain: frequencies and phase ramps.

Phases are computed in float64, whatever the data are: at 500 pixels float32 phases cost three digits.
The Nyquist bin of an even size belongs to both signs of its frequency, so its phase is the mean of the two, the
real part; that is what makes the shifted signal real and the shift the trigonometric interpolation.
"""

import itertools

import torch
from torch import Tensor


def half_frequencies(length: int) -> Tensor:
    """Frequencies of `rfft` in cycles per sample, float64, [length // 2 + 1]."""
    return torch.fft.rfftfreq(length, dtype=torch.float64)


def frequencies(length: int) -> Tensor:
    """Frequencies of `fft` in cycles per sample, float64, [length]."""
    return torch.fft.fftfreq(length, dtype=torch.float64)


def shift_phases(frequencies: Tensor, shifts: Tensor) -> Tensor:
    """Factors that turn the spectrum of f(x) into that of f(x + shift).

    Args:
        frequencies: In cycles per sample, float64, [K].
        shifts: In samples, float64, [...].

    Returns:
        exp(2 pi i shift k), real at the Nyquist bin, complex128, [..., K].
    """
    angle = 2 * torch.pi * shifts[..., None] * frequencies
    return real_at_nyquist(torch.polar(torch.ones_like(angle), angle), frequencies)


def real_at_nyquist(factors: Tensor, frequencies: Tensor) -> Tensor:
    """Factors by which the spectrum of a real signal may be multiplied: at the Nyquist frequency they become real.

    Both signs of that frequency share one bin, which gets the mean of their factors.

    Args:
        factors: Complex, conjugate at the negative frequency, [..., K].
        frequencies: In cycles per sample, [K].
    """
    return torch.complex(factors.real, torch.where(frequencies.abs() == 0.5, 0.0, factors.imag))


def complex_dtype(dtype: torch.dtype) -> torch.dtype:
    """The complex type that goes with a real one: complex128 for float64, complex64 for all others."""
    return torch.complex128 if dtype == torch.float64 else torch.complex64


def is_fast(length: int) -> bool:
    """Whether FFTs are fast at a length: its only prime factors are 2, 3 and 5."""
    return pow(30, length.bit_length(), length) == 0


def next_fast_length(least: int) -> int:
    """The smallest length, at least `least`, at which FFTs are fast."""
    return next(filter(is_fast, itertools.count(least)))


def next_fast_even(least: int) -> int:
    """The smallest even length, at least `least`, at which FFTs are fast."""
    return 2 * next_fast_length(-(-least // 2))
