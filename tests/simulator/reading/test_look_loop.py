"""Compiled look-ups against PyTorch's operations."""

import numpy as np
import pytest
import torch

from lfref.functional.jit import compiled
from lfref.simulator import lookups


@compiled
def read_linearly(samples, start, rows, columns, i, j, result):
    for point in range(i.size):
        found = lookups.linear_of_look_loop(samples, start, rows, columns, i[point], j[point])
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
    expected = lookups.linear(torch.from_numpy(samples).movedim(-1, 0), *places)[0, :, 0]
    np.testing.assert_allclose(result, expected, atol=1e-6)
    at_sample = samples[2, 5] / 2 + samples[3, 5] / 2
    np.testing.assert_allclose(result[:, 2], at_sample, atol=1e-6)
