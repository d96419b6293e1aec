"""The compiled box blur against sums written out."""

import numpy as np
import pytest

from lfref.simulator import blurs


@pytest.mark.parametrize("size", [3, 5, 11])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_each_sample_is_the_mean_of_a_box(size, kind):
    samples = np.random.default_rng(0).random((6, 8, 4)).astype(kind)
    result = np.empty((6 + size - 1, 8 + size - 1, 4), kind)
    blurs.box_mean(samples, size, result)
    padded = np.pad(samples, ((size - 1,) * 2, (size - 1,) * 2, (0, 0)), mode="edge")
    for row in range(result.shape[0]):
        for column in range(result.shape[1]):
            expected = padded[row : row + size, column : column + size].mean((0, 1))
            np.testing.assert_allclose(result[row, column], expected, atol=1e-6)
