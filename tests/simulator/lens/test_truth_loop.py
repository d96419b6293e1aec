"""Compositing through cells against plain NumPy."""

import numpy as np

from lfref.simulator import truth_loops
from lfref.simulator.truth_loops import Places, Smoothed, Through
from tests.simulator.lens.test_smooth_loop import rgba, smoothed


def test_cells_are_looked_up_between_samples_and_composited():
    random = np.random.default_rng(1)
    pictures = [rgba(random), rgba(random, empty=slice(0, 5))]
    parts = [smoothed(samples, np.ones(1), np.ones(1)) for samples in pictures]
    layers = Smoothed(*(np.stack(values) for values in zip(*parts, strict=True)))
    positions = Places(random.uniform(0, 3, (2, 2)), random.uniform(0, 3, (2, 3)))
    weights = np.array([[0.1, 0.3, 0.0], [0.2, 0.1, 0.3]])
    picture, through = np.empty((3, 5, 6)), Through(np.zeros(3), np.zeros(2), weights, 0.0, 0.0)
    truth_loops.add_shifted(layers, positions, through, picture, 0, 2)
    truth_loops.add_shifted(layers, positions, through, picture, 2, 5)
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
