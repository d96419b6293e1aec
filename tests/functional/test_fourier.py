"""Frequencies and phase ramps: shifts are exact for band-limited signals, real for all, and add up."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.functional import fourier


def shifted(signal, shift):
    phases = fourier.shift_phases(fourier.half_frequencies(len(signal)), torch.tensor(shift, dtype=torch.float64))
    return torch.fft.irfft(torch.fft.rfft(signal) * phases, n=len(signal))


@pytest.mark.parametrize("length", [1, 2, 5, 8, 375, 540])
def test_frequencies_are_those_of_numpy(length):
    np.testing.assert_array_equal(fourier.frequencies(length), np.fft.fftfreq(length))
    np.testing.assert_array_equal(fourier.half_frequencies(length), np.fft.rfftfreq(length))
    assert fourier.frequencies(length).dtype == fourier.half_frequencies(length).dtype == torch.float64


@pytest.mark.parametrize("length", [9, 10])
@pytest.mark.parametrize("shift", [0.0, 0.3, -1.7, 4.0, 123.25])
def test_a_shifted_cosine_is_the_cosine_read_at_x_plus_shift(length, shift):
    x = torch.arange(length, dtype=torch.float64)
    for cycles in range((length + 1) // 2):
        wave = torch.cos(2 * torch.pi * cycles * x / length + 0.4)
        expected = torch.cos(2 * torch.pi * cycles * (x + shift) / length + 0.4)
        torch.testing.assert_close(shifted(wave, shift), expected, atol=1e-12, rtol=0)


def test_the_nyquist_bin_is_the_mean_of_both_its_signs():
    wave = torch.tensor([1.0, -1.0], dtype=torch.float64).repeat(4)
    for shift in (0.25, 0.5, 1.0):
        torch.testing.assert_close(shifted(wave, shift), wave * math.cos(math.pi * shift), atol=1e-15, rtol=0)
    for frequencies in (fourier.frequencies(8), fourier.half_frequencies(8)):
        phases = fourier.shift_phases(frequencies, torch.tensor([0.3, -2.2], dtype=torch.float64))
        assert bool((phases.imag[:, 4] == 0).all())
        assert bool((phases.imag[:, 1:4] != 0).all())


@given(shift=st.integers(-20, 20), length=st.integers(1, 24))
@settings(max_examples=40, deadline=None)
def test_a_whole_shift_is_a_roll(shift, length):
    signal = torch.randn(length, dtype=torch.float64)
    torch.testing.assert_close(shifted(signal, float(shift)), signal.roll(-shift), atol=1e-12, rtol=0)


@given(first=st.floats(-9, 9), second=st.floats(-9, 9))
@settings(max_examples=40, deadline=None)
def test_shifts_of_an_odd_length_add_up(first, second):
    signal = torch.randn(11, dtype=torch.float64)
    torch.testing.assert_close(
        shifted(shifted(signal, first), second), shifted(signal, first + second), atol=1e-11, rtol=0
    )


def test_the_phase_at_500_pixels_keeps_its_digits():
    # The sum of the geometric series is known in closed form; float32 phases would be off by 1e-4.
    frequencies = fourier.frequencies(541)
    phases = fourier.shift_phases(frequencies, torch.tensor(500.5, dtype=torch.float64))
    turns = frequencies.numpy().astype(np.longdouble) * np.longdouble(500.5)
    turns -= np.rint(turns)
    expected = np.exp(2j * np.pi * turns.astype(np.float64))
    np.testing.assert_allclose(phases.numpy(), expected, atol=1e-12)


def test_fast_lengths_are_the_next_without_large_prime_factors():
    lengths = [1, 2, 3, 4, 5, 6, 8, 8, 9, 10, 12, 12, 15, 15, 15, 16]
    assert [fourier.next_fast_length(least) for least in range(1, 17)] == lengths
    assert fourier.next_fast_length(103) == 108
    assert fourier.next_fast_length(1025) == 1080
    assert [n for n in range(1, 17) if fourier.is_fast(n)] == sorted(set(lengths))


@given(least=st.integers(1, 3000))
@settings(max_examples=60, deadline=None)
def test_the_next_fast_even_length_is_the_first_that_is_both(least):
    found = fourier.next_fast_even(least)
    assert found >= least
    assert found % 2 == 0
    assert fourier.is_fast(found)
    assert not [n for n in range(least, found) if n % 2 == 0 and fourier.is_fast(n)]
