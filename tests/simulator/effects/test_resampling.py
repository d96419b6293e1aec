"""Resampling at separable positions: polynomials and samples exactly, waves nearly, the edge held."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref import geometry
from lfref.simulator.effects import displacement


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


def test_near_the_edge_only_samples_nearby_count():
    matrix = displacement.matrix(torch.tensor([-9.0, 9.0], dtype=torch.float64), 20)
    assert bool((matrix[0, :5] != 0).all())
    assert not matrix[0, 5:].any()
    torch.testing.assert_close(matrix[1], matrix[0].flip(0))


@given(position=st.floats(-12, 12))
@settings(max_examples=40, deadline=None)
def test_brightness_is_kept_everywhere(position):
    matrix = displacement.matrix(torch.tensor([position], dtype=torch.float64), 11)
    assert float(matrix.sum()) == pytest.approx(1, abs=1e-12)


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


def test_rows_and_columns_are_read_where_each_says():
    views = torch.rand(2, 3, 3, 12, 14, dtype=torch.float64)
    y, x = geometry.angular_offsets(12) + 1, geometry.angular_offsets(14) - 2
    read = displacement.resample(views, y, x)
    torch.testing.assert_close(read[..., :-1, 2:], views[..., 1:, :-2], atol=0, rtol=0)
    one = displacement.resample(views, torch.stack([y - 1, y])[:, None, None], geometry.angular_offsets(14))
    torch.testing.assert_close(one[0], views[0], atol=0, rtol=0)
    torch.testing.assert_close(one[1, ..., :-1, :], views[1, ..., 1:, :], atol=0, rtol=0)
