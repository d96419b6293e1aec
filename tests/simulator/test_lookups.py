"""Cubic and linear look-ups, by PyTorch and in compiled loops."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lfref.functional.jit import compiled
from lfref.simulator import lookups


def quadratic(i, j):
    return 0.3 + 0.02 * i - 0.01 * j + 0.001 * i**2 - 0.002 * i * j + 0.0015 * j**2


def bitmap(height=20, width=24, channels=4):
    return torch.rand(channels, height, width)


@given(st.floats(0, 1))
def test_weights_add_up_to_one_and_reproduce_quadratics(t):
    weights = lookups.cubic_weights(torch.tensor(t, dtype=torch.float64))
    offsets = torch.tensor([-1.0, 0.0, 1.0, 2.0], dtype=torch.float64)
    for power in range(3):
        assert abs(float((weights * offsets**power).sum()) - t**power) < 1e-12


def test_quadratics_are_read_exactly():
    j, i = torch.meshgrid(torch.arange(20.0), torch.arange(24.0), indexing="ij")
    at_i, at_j = torch.rand(2, 5, 6, 7, dtype=torch.float64) * 15 + 2
    read = lookups.cubic_at(quadratic(i, j)[None], at_i, at_j)
    torch.testing.assert_close(read[:, 0], quadratic(at_i, at_j).float(), atol=2e-6, rtol=0)


def test_samples_are_read_as_they_are():
    samples = bitmap()
    i, j = torch.arange(24.0, dtype=torch.float64)[None, None], torch.arange(20.0, dtype=torch.float64)[None, :, None]
    assert torch.equal(lookups.cubic_on_grid(samples, i, j)[0], samples)


def test_grids_are_read_as_points_are_within_and_beyond_the_bitmap():
    samples = bitmap()
    i, j = torch.rand(3, 1, 30, dtype=torch.float64) * 40 - 8, torch.rand(3, 25, 1, dtype=torch.float64) * 40 - 8
    points = lookups.cubic_at(samples, i.expand(3, 25, 30), j.expand(3, 25, 30))
    torch.testing.assert_close(lookups.cubic_on_grid(samples, i, j), points, atol=1e-6, rtol=0)


def test_far_beyond_its_ends_a_bitmap_goes_on():
    samples = bitmap()
    far = torch.tensor([[[-1e6, 1e6]]], dtype=torch.float64)
    read = lookups.cubic_on_grid(samples, far, far.mT)[0]
    torch.testing.assert_close(read, samples[:, [0, -1]][..., [0, -1]])


def test_legal_colours_are_positive_and_no_more_opaque_than_one():
    rgba = torch.tensor([[0.5, 0.3], [-0.1, 0.2], [1.2, 0.0], [1.25, -0.1]])[None, :, None]
    expected = torch.tensor([[0.4, 0.0], [0.0, 0.0], [0.96, 0.0], [1.0, 0.0]])[None, :, None]
    torch.testing.assert_close(lookups.clip_premultiplied(rgba), expected)


@compiled
def read_linearly(samples, start, rows, columns, i, j, result):
    for point in range(i.size):
        found = lookups.linear_sample(samples, start, rows, columns, i[point], j[point])
        result[0, point], result[1, point], result[2, point], result[3, point] = found


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_linear_look_ups_go_on_beyond_the_ends(kind):
    random = np.random.default_rng(0)
    samples = random.random((7, 9, 4)).astype(kind)
    i, j = random.uniform(-4, 14, (2, 200))
    i[:3], j[:3] = (0, 8, 5), (6, 0, 2.5)
    row = np.concatenate([np.full(5, np.nan, kind), samples.reshape(-1)])
    result = np.empty((4, 200), kind)
    read_linearly(row, 5, 7, 9, i, j, result)
    places = torch.from_numpy(i)[None, None], torch.from_numpy(j)[None, None]
    expected = lookups.linear_at(torch.from_numpy(samples).movedim(-1, 0), *places)[0, :, 0]
    np.testing.assert_allclose(result, expected, atol=1e-6)
    at_sample = samples[2, 5] / 2 + samples[3, 5] / 2
    np.testing.assert_allclose(result[:, 2], at_sample, atol=1e-6)
