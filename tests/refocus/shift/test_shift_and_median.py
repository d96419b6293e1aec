"""Medians of shifted views: NumPy's median, and what lies behind leaves."""

import numpy as np
import pytest
import torch

from lfref.refocus.shift.shift_and_median import shift_and_median, weighted_median
from lfref.refocus.shift.shift_and_sum import shift_and_sum


@pytest.mark.parametrize(("grid", "slope"), [((3, 3), -1), ((3, 3), 0), ((3, 3), 2), ((2, 4), -2), ((2, 4), 2)])
def test_it_is_the_median_of_the_views_that_have_a_sample_there(grid, slope):
    views = torch.rand(2, *grid, 3, 12, 15, dtype=torch.float64)
    found = shift_and_median(views, [float(slope)], "nearest")[:, 0]
    offsets = [np.arange(n) - (n - 1) / 2 for n in grid]
    for y, x in np.ndindex(12, 15):
        places = [(v, u, int(y + slope * offsets[0][v]), int(x + slope * offsets[1][u])) for v, u in np.ndindex(grid)]
        there = [views[:, v, u, :, i, j].numpy() for v, u, i, j in places if 0 <= i < 12 and 0 <= j < 15]
        np.testing.assert_allclose(found[:, :, y, x], np.median(there, axis=0))


def test_weights_count_like_repeated_samples():
    samples, weights = torch.rand(5, 2, 3, 4, 6), torch.tensor([1.0, 0, 3, 2, 1])
    repeated = samples.repeat_interleave(weights.long(), 0)
    expected = torch.from_numpy(np.median(repeated, axis=0))
    found = weighted_median(samples, (weights / 7)[:, None, None].expand(5, 4, 6))
    torch.testing.assert_close(found, expected)


def test_aperture_and_positions_choose_the_views():
    views = torch.rand(3, 3, 1, 16, 20)
    middle = torch.zeros(3, 3)
    middle[1, 1] = 1
    torch.testing.assert_close(shift_and_median(views, [0.7], weights=middle), views[1, 1][None])
    still = torch.zeros(3, 3, 2, dtype=torch.float64)
    median = views.reshape(9, 1, 16, 20).median(0).values
    torch.testing.assert_close(shift_and_median(views, [0.7], positions=still), median[None])


def test_it_looks_through_leaves_where_the_mean_does_not():
    random = torch.Generator().manual_seed(0)
    wall = torch.rand(3, 60, 80, generator=random) * 0.3 + 0.5
    leaves = torch.rand(90, 110, generator=random) < 0.2
    views = torch.stack(
        [
            torch.stack([wall.masked_fill(leaves[3 * v : 3 * v + 60, 3 * u : 3 * u + 80], 0) for u in range(7)])
            for v in range(7)
        ]
    )
    through, mean = shift_and_median(views, [0.0])[0], shift_and_sum(views, [0.0])[0]
    error = [float((picture - wall).abs().mean()) for picture in (through, mean)]
    assert error[0] < 1e-3 < 0.05 < error[1]


def test_it_has_derivatives():
    views = torch.rand(2, 3, 1, 6, 7, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda light: shift_and_median(light, [0.3, -0.6]), views)
