"""The compiled filters against plain NumPy."""

import numpy as np
import pytest

from lfref.simulator import truth_loops

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
    truth_loops.smooth(samples, down, across, result, first, last)
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


@pytest.mark.parametrize("taps", [1, 4])
def test_pixels_pick_what_a_filter_makes_there(taps):
    random = np.random.default_rng(0)
    samples, down, across = random.random((3, ROWS, COLUMNS)), random.random(taps), random.random(5)
    result = np.ones((3, 5, 5))
    truth_loops.pick(samples, down, across, 1, 2, PHASES, result)
    windows = np.lib.stride_tricks.sliding_window_view(samples, (taps, 5), (1, 2))[:, 1:11:2, 2:12:2]
    np.testing.assert_allclose(result, 1 + np.einsum("cyxab,a,b->cyx", windows, down, across))
