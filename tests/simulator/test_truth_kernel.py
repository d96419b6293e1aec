"""The compiled loops of the truth against plain NumPy."""

import numpy as np
import pytest

from lfref.simulator import truth_kernel
from lfref.simulator.truth_kernel import Layers, Positions

ROWS, COLUMNS, PHASES = 14, 16, 2


def rgba(random: np.random.Generator, *, empty: slice = slice(0)) -> np.ndarray:
    """A random layer, transparent in some rows and columns."""
    samples = random.random((4, ROWS, COLUMNS))
    samples[:, empty] = 0
    samples[:, :, empty] = 0
    samples[:3] *= samples[3]
    return samples


def smoothed(samples: np.ndarray, down: np.ndarray, across: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    result = np.empty((4, ROWS, PHASES, COLUMNS // PHASES))
    first, last = np.empty((2, ROWS), np.int64)
    truth_kernel.smooth(samples, down, across, result, first, last)
    return result, first, last


@pytest.mark.parametrize("empty", [slice(0), slice(0, 9), slice(6, 16), slice(0, 16)])
@pytest.mark.parametrize("across", [[1.0], [0.25, 0.5, 0.25], [0.1, 0.2, 0.4, 0.2, 0.1]])
def test_a_layer_is_filtered_as_if_its_ends_went_on(empty, across):
    samples, taps = rgba(np.random.default_rng(0), empty=empty), np.array(across)
    down = np.array([0.3, 0.4, 0.3])
    result, first, last = smoothed(samples, down, taps)
    padded = np.pad(samples, ((0, 0), (1, 1), (taps.size // 2,) * 2), mode="edge")
    expected = np.einsum(
        "cyxab,a,b->cyx", np.lib.stride_tricks.sliding_window_view(padded, (3, taps.size), (1, 2)), down, taps
    )
    np.testing.assert_allclose(result.transpose(0, 1, 3, 2).reshape(samples.shape), expected, atol=1e-12)
    outside = (np.arange(COLUMNS // PHASES) < first[:, None]) | (np.arange(COLUMNS // PHASES) >= last[:, None])
    assert not result[3].transpose(0, 2, 1)[outside].any()


def test_cells_are_looked_up_between_samples_and_composited():
    random = np.random.default_rng(1)
    pictures = [rgba(random), rgba(random, empty=slice(0, 5))]
    parts = [smoothed(samples, np.ones(1), np.ones(1)) for samples in pictures]
    layers = Layers(*(np.stack(values) for values in zip(*parts, strict=True)))
    positions = Positions(random.uniform(0, 3, (2, 2)), random.uniform(0, 3, (2, 3)))
    weights = np.array([[0.1, 0.3, 0.0], [0.2, 0.1, 0.3]])
    picture = np.empty((3, 5, 6))
    truth_kernel.add_cells(layers, positions, weights, picture, 0, 2)
    truth_kernel.add_cells(layers, positions, weights, picture, 2, 5)
    expected = sum(
        weights[j, i] * composite([look_up(pictures[k], positions.rows[k, j], positions.columns[k, i]) for k in (0, 1)])
        for j in range(2)
        for i in range(3)
    )
    np.testing.assert_allclose(picture, expected, atol=1e-12)


def look_up(samples: np.ndarray, row: float, column: float) -> np.ndarray:
    """Linear, every second sample."""
    for axis, start in ((1, row), (2, column)):
        whole, share = int(start), start % 1
        near, next_one = (np.take(samples, np.arange(start, samples.shape[axis]), axis) for start in (whole, whole + 1))
        near = np.take(near, np.arange(next_one.shape[axis]), axis)
        samples = (1 - share) * near + share * next_one
    return samples[:, :10:2, :12:2]


def composite(layers: list[np.ndarray]) -> np.ndarray:
    far, near = layers
    return near[:3] + far[:3] * (1 - near[3])
