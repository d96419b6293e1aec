"""Interpolation through eight samples: polynomials and waves as the theory says, pictures as by matrices."""

import math

import pytest
import torch

from lfref import geometry
from lfref.functional import interpolation
from lfref.simulator.effects import optics


@pytest.mark.parametrize("degree", range(8))
def test_polynomials_are_reproduced(degree):
    t = torch.arange(0, 1, 0.07, dtype=torch.float64)
    taps = torch.tensor(interpolation.TAPS, dtype=torch.float64)
    torch.testing.assert_close(interpolation.weights(t) @ taps**degree, t**degree, atol=1e-10, rtol=0)


def half_way_gain(frequency):
    """What is left of a wave half-way between samples: 1 / cos as a series in sin^2, cut after four terms."""
    sine, cosine = math.sin(math.pi * frequency), math.cos(math.pi * frequency)
    return cosine * sum(math.comb(2 * k, k) / 4**k * sine ** (2 * k) for k in range(4))


@pytest.mark.parametrize("frequency", [0.05, 0.2, 0.4])
def test_a_wave_is_weakened_most_half_way_between_samples(frequency):
    positions = torch.linspace(-10, 10, 201, dtype=torch.float64)
    wave = torch.polar(torch.ones(41, dtype=torch.float64), 2 * math.pi * frequency * geometry.angular_offsets(41))
    expected = torch.polar(torch.ones(201, dtype=torch.float64), 2 * math.pi * frequency * positions)
    gain = (optics.matrix(positions, 41).to(wave) @ wave) / expected
    assert float(gain[5::10].real.min()) == pytest.approx(half_way_gain(frequency), abs=1e-12)
    assert float((gain - 1).abs().max()) == pytest.approx(1 - half_way_gain(frequency), abs=1e-12)


def test_views_are_read_as_by_matrices_also_beyond_their_edge():
    views = torch.rand(2, 3, 3, 20, 33, dtype=torch.float64)
    rows = geometry.angular_offsets(20) * 1.02 + torch.rand(2, 3, 1, 1, dtype=torch.float64)
    columns = geometry.angular_offsets(33) - 30 * torch.rand(2, 3, 3, 1, dtype=torch.float64)
    expected = optics.resample(views, rows.expand(2, 3, 3, 20), columns)
    torch.testing.assert_close(interpolation.resample(views, rows, columns), expected, atol=1e-12, rtol=0)


def test_whole_positions_keep_samples():
    views = torch.rand(1, 1, 1, 9, 12)
    rows, columns = geometry.angular_offsets(9), geometry.angular_offsets(12)
    assert torch.equal(interpolation.resample(views, rows, columns), views)
    assert torch.equal(interpolation.resample(views, rows, columns + 2)[..., :-2], views[..., 2:])
