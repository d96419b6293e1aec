"""Effects that move pictures: resampling of polynomials, waves and samples, chromatic aberration, misalignment."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref import geometry
from lfref.refocus.fourier import exact
from lfref.simulator.effects import optics
from lfref.simulator.effects.optics import Chromatic, Misalignment


@given(t=st.floats(0, 1, exclude_max=True), degree=st.integers(0, 7))
@settings(max_examples=60, deadline=None)
def test_polynomials_are_reproduced(t, degree):
    weights = displacement.weights(torch.tensor(t, dtype=torch.float64))
    read = sum(weight * tap**degree for weight, tap in zip(weights.tolist(), displacement.TAPS, strict=True))
    assert read == pytest.approx(t**degree, abs=1e-10)


@pytest.mark.parametrize("length", [1, 2, 5, 8, 13])
def test_whole_positions_are_the_samples_themselves(length):
    identity = displacement.matrix(geometry.angular_offsets(length), length)
    assert torch.equal(identity, torch.eye(length, dtype=torch.float64))


@pytest.mark.parametrize("length", [1, 3, 20])
def test_beyond_the_edge_the_outermost_sample_is_held(length):
    matrix = displacement.matrix(torch.tensor([-1e3, 1e3], dtype=torch.float64), length)
    assert matrix[0, 0] == matrix[1, -1] == 1
    assert float(matrix.abs().sum()) == 2


def half_way_gain(frequency):
    """What is left of a wave half-way between samples: 1 / cos as a series in sin^2, cut after four terms."""
    sine, cosine = math.sin(math.pi * frequency), math.cos(math.pi * frequency)
    return cosine * sum(math.comb(2 * k, k) / 4**k * sine ** (2 * k) for k in range(4))


@pytest.mark.parametrize("frequency", [0.05, 0.1, 0.2, 0.25, 0.4])
def test_a_wave_is_weakened_most_half_way_between_samples(frequency):
    positions = torch.linspace(-10, 10, 201, dtype=torch.float64)
    wave = torch.polar(torch.ones(41, dtype=torch.float64), 2 * math.pi * frequency * geometry.angular_offsets(41))
    expected = torch.polar(torch.ones(201, dtype=torch.float64), 2 * math.pi * frequency * positions)
    gain = (displacement.matrix(positions, 41).to(wave) @ wave) / expected
    assert float(gain[5::10].real.min()) == pytest.approx(half_way_gain(frequency), abs=1e-12)
    assert float((gain - 1).abs().max()) == pytest.approx(1 - half_way_gain(frequency), abs=1e-12)


def test_each_colours_radius_shrinks_by_its_magnification():
    y, x = geometry.angular_offsets(41)[:, None], geometry.angular_offsets(50)
    views = (x**2 + y**2).expand(2, 2, 3, 41, 50)
    sizes = (1.03, 1.0, 0.96)
    result = Chromatic(sizes).apply(views, torch.Generator())
    inner = (..., slice(6, -6), slice(6, -6))
    for channel, size in enumerate(sizes):
        torch.testing.assert_close(result[:, :, channel][inner], views[:, :, channel][inner] / size**2)


def test_each_colours_disparity_is_added_to_the_surfaces():
    disparity, more = 0.4, (0.3, 0.0, -0.25)
    p, q = geometry.angular_offsets(3)[None, :, None, None], geometry.angular_offsets(2)[:, None, None, None]
    y, x = geometry.angular_offsets(30)[:, None], geometry.angular_offsets(31)

    def slanted(d):
        return (x - d * p) + 2 * (y - d * q)

    views = slanted(disparity)[:, :, None].expand(2, 3, 3, 30, 31)
    result = Chromatic(disparity=more).apply(views, torch.Generator())
    for channel, extra in enumerate(more):
        expected = slanted(disparity + extra)
        torch.testing.assert_close(result[:, :, channel, 5:-5, 5:-5], expected[..., 5:-5, 5:-5])


def moved_by(sigma, views, seed=0):
    return Misalignment(sigma).apply(views, torch.Generator().manual_seed(seed))


def band_limited(height, width, share):
    """A periodic picture without frequencies above `share` cycles a pixel, of spread 1."""
    spectrum = torch.fft.rfft2(torch.randn(height, width, dtype=torch.float64))
    low = (exact.frequencies(height)[:, None].abs() <= share) & (exact.half_frequencies(width) <= share)
    picture = torch.fft.irfft2(spectrum * low, s=(height, width))
    return picture / picture.std()


@pytest.mark.parametrize(("share", "tolerance"), [(0.1, 1e-4), (0.15, 2e-3)])
def test_a_band_limited_picture_moves_as_by_fouriers_shift(share, tolerance):
    picture, (dx, dy) = band_limited(48, 50, share), (0.37, -1.2)
    result = optics.shift(picture.expand(1, 1, 3, 48, 50), torch.tensor([[[dx, dy]]]))[0, 0, 0]
    down = exact.shift_phases(exact.frequencies(48), torch.tensor(-dy, dtype=torch.float64))[:, None]
    across = exact.shift_phases(exact.half_frequencies(50), torch.tensor(-dx, dtype=torch.float64))
    expected = torch.fft.irfft2(torch.fft.rfft2(picture) * down * across, s=(48, 50))
    torch.testing.assert_close(result[8:-8, 8:-8], expected[8:-8, 8:-8], atol=tolerance, rtol=0)


def test_whole_shifts_move_to_the_right_and_down():
    views = torch.rand(2, 2, 3, 9, 9)
    shifts = torch.tensor([[[0, 0], [1, 0]], [[0, 1], [-2, 3]]])
    result = optics.shift(views, shifts)
    assert torch.equal(result[0, 0], views[0, 0])
    assert torch.equal(result[0, 1, ..., 1:], views[0, 1, ..., :-1])
    assert torch.equal(result[1, 0, :, 1:], views[1, 0, :, :-1])
    assert torch.equal(result[1, 1, :, 3:, :-2], views[1, 1, :, :-3, 2:])


def test_shifts_spread_as_sigma_says():
    # On a ramp a shift is a difference of values.
    ramp = torch.arange(20, dtype=torch.float64)
    moved = ramp[10] - moved_by(0.2, ramp.expand(60, 60, 3, 1, 20))[:, :, 0, 0, 10]
    assert float(moved.std()) == pytest.approx(0.2, rel=0.05)
    assert abs(float(moved.mean())) < 0.02


def test_all_colours_of_a_view_move_together_and_each_seed_moves_differently():
    views = torch.rand(3, 3, 1, 8, 8).expand(3, 3, 3, 8, 8)
    result = moved_by(0.5, views)
    assert torch.equal(result[:, :, 0], result[:, :, 2])
    assert not torch.equal(result, moved_by(0.5, views, seed=1))
