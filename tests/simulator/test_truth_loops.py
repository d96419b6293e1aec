"""The compiled loops of shifted layers against NumPy; `test_truth` compares all loops with PyTorch's operations."""

import numpy as np
import pytest
import torch

from lfref.simulator import rays, truth_loops
from lfref.simulator.truth_loops import ApertureCells, BlurredLayers, CellPositions, LookUps, TracedLayers
from tests.simulator import eager

ROWS, COLUMNS, PHASES = 14, 16, 2


def random_layer(random, *, empty=slice(0)):
    """Samples of a layer that is transparent in some rows and columns."""
    samples = random.random((4, ROWS, COLUMNS))
    samples[:, empty] = 0
    samples[:, :, empty] = 0
    samples[:3] *= samples[3]
    return samples


def blurred(samples, down, across):
    result = np.empty((4, ROWS, PHASES, COLUMNS // PHASES))
    first, last = np.empty((2, ROWS), np.int64)
    truth_loops.blur_layer(samples, down, across, result, first, last)
    return result, first, last


@pytest.mark.parametrize("empty", [slice(0), slice(0, 9), slice(6, 16), slice(0, 16)])
@pytest.mark.parametrize("across", [[1.0], [0.1, 0.2, 0.4, 0.2, 0.1]])
def test_a_layer_is_filtered_as_if_its_ends_went_on(empty, across):
    samples, taps = random_layer(np.random.default_rng(0), empty=empty), np.array(across)
    down = np.array([0.3, 0.4, 0.3])
    result, first, last = blurred(samples, down, taps)
    padded = np.pad(samples, ((0, 0), (1, 1), (taps.size // 2,) * 2), mode="edge")
    expected = np.einsum(
        "cyxab,a,b->cyx", np.lib.stride_tricks.sliding_window_view(padded, (3, taps.size), (1, 2)), down, taps
    )
    np.testing.assert_allclose(result.transpose(0, 1, 3, 2).reshape(samples.shape), expected, atol=1e-12)
    outside = (np.arange(COLUMNS // PHASES) < first[:, None]) | (np.arange(COLUMNS // PHASES) >= last[:, None])
    assert not result[3].transpose(0, 2, 1)[outside].any()


@pytest.mark.parametrize("taps", [1, 4])
def test_a_filter_is_applied_at_pixels(taps):
    random = np.random.default_rng(0)
    samples, down, across = random.random((3, ROWS, COLUMNS)), random.random(taps), random.random(5)
    result = np.ones((3, 5, 5))
    truth_loops.filter_at_pixels(samples, down, across, 1, 2, PHASES, result)
    windows = np.lib.stride_tricks.sliding_window_view(samples, (taps, 5), (1, 2))[:, 1:11:2, 2:12:2]
    np.testing.assert_allclose(result, 1 + np.einsum("cyxab,a,b->cyx", windows, down, across))


def test_cells_are_looked_up_between_samples_and_composited():
    random = np.random.default_rng(1)
    pictures = [random_layer(random), random_layer(random, empty=slice(0, 5))]
    parts = [blurred(samples, np.ones(1), np.ones(1)) for samples in pictures]
    layers = BlurredLayers(*(np.stack(values) for values in zip(*parts, strict=True)))
    positions = CellPositions(random.uniform(0, 3, (2, 2)), random.uniform(0, 3, (2, 3)))
    weights = np.array([[0.1, 0.3, 0.0], [0.2, 0.1, 0.3]])
    picture, cells = np.empty((3, 5, 6)), ApertureCells(np.zeros(3), np.zeros(2), weights, 0.0, 0.0)
    tables = rays.ray_layers([], [], [], [])
    traced = TracedLayers(tables, rays.atlas([], 4), np.arange(2), np.zeros((2, 2), np.bool_))
    for top, end in ((0, 2), (2, 5)):
        truth_loops.composite_fixed(layers, positions, traced, cells, picture, top, end)
    expected = np.zeros((3, 5, 6))
    for j, i in np.ndindex(2, 3):
        far, near = (linear(pictures[k], positions.rows[k, j], positions.columns[k, i]) for k in (0, 1))
        expected += weights[j, i] * (near[:3] + far[:3] * (1 - near[3]))
    np.testing.assert_allclose(picture, expected, atol=1e-12)


def linear(samples, row, column):
    """Every second sample from a position on, interpolated linearly."""
    for axis, start in ((1, row), (2, column)):
        whole, share = int(start), start % 1
        length = samples.shape[axis] - whole - 1
        upper, lower = (np.take(samples, np.arange(first, first + length), axis) for first in (whole, whole + 1))
        samples = (1 - share) * upper + share * lower
    return samples[:, :10:2, :12:2]


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("step", [1.0, 0.993, -1.3])
def test_runs_of_rays_read_a_window_linearly_and_its_edge_beyond(kind, step):
    random = np.random.default_rng(0)
    rows, columns, top, left, width = 7, 12, -3, -5, 40
    samples = random.random((4, rows, columns)).astype(kind)
    by_phase = samples.reshape(4, rows, columns // 4, 4).swapaxes(2, 3)
    other = rays.AtlasEntry(np.full((4, 2, 4, 1), np.nan, kind), np.zeros((2, 4)), 0, 0)
    windows = rays.atlas([other, rays.AtlasEntry(by_phase, samples[3], top, left)], 4)
    at = np.stack([-2 + step * np.arange(width) / 8, random.uniform(-1.5, 1.5, width).round(1)])
    at[1, 10:25] = 0.125
    look_ups = LookUps(np.zeros(width, np.int64), np.zeros(width, kind), np.zeros(width, kind))
    rgba = np.full((4, width), -1.0, kind)
    truth_loops._find_samples(windows, 1, at, 3, 38, look_ups)
    truth_loops._read_runs(windows, 1, 3, 38, look_ups, rgba)
    places = (torch.from_numpy(4 * line - start)[None, None] for line, start in zip(at, (left, top), strict=True))
    expected = eager.linear_at(torch.from_numpy(samples), *places)[0, :, 0]
    np.testing.assert_allclose(rgba[:, 3:38], expected[:, 3:38], atol=1e-6)
    assert (rgba[:, :3] == -1).all()
    assert (rgba[:, 38:] == -1).all()
