"""Disagreement of views: a slow reference, votes that do not depend on contrast, and how much noise there is."""

import math

import numpy as np
import pytest
import torch

from lfref.functional import neighbours, splines
from lfref.refocus.disparity import cost_volume
from lfref.refocus.disparity.cost_volume import grey_views
from tests.refocus.conftest import shifted_views, texture


def of(views):
    return grey_views(views, torch.ones(views.shape[:2]))


def read(view, p, q):
    """A view by cubic convolution, its outermost samples going on; None beyond its borders."""
    height, width = view.shape
    if not (-1e-6 <= p <= height - 1 + 1e-6 and -1e-6 <= q <= width - 1 + 1e-6):
        return None
    rows, columns = math.floor(p), math.floor(q)
    return sum(
        a * b * view[min(max(rows + i - 1, 0), height - 1), min(max(columns + j - 1, 0), width - 1)]
        for i, a in enumerate(splines.weights(p - rows))
        for j, b in enumerate(splines.weights(q - columns))
    )


def slow_share(light, slope, spread, y, x):
    seen = [
        read(view, y + slope * v, x + slope * u) for view, (v, u) in zip(light.samples, light.positions, strict=True)
    ]
    first = np.mean([seen[k] for k in light.middle if seen[k] is not None])
    there = np.array([value for value in seen if value is not None])
    weights = spread / (spread + (there - first) ** 2)
    squares = (there - (weights * there).sum() / weights.sum()) ** 2
    return (squares / (squares + spread)).mean()


@pytest.mark.parametrize("grid", [(3, 3), (2, 4), (1, 5)])
def test_shares_are_those_of_a_slow_loop(grid):
    light = of(torch.rand(*grid, 1, 9, 11))
    spread = (0.01 + 0.1 * torch.rand(9, 11)).numpy()
    slopes = torch.tensor([-1.3, 0.0, 0.37, 1.0], dtype=torch.float64)
    found = cost_volume.disagreements(light, slopes, spread)
    expected = [
        [[slow_share(light, s, spread[y, x], y, x) for x in range(11)] for y in range(9)] for s in slopes.tolist()
    ]
    np.testing.assert_allclose(found, np.array(expected), atol=2e-5)


def test_some_rows_are_those_of_all_rows():
    light, spread = of(torch.rand(3, 3, 1, 12, 10)), np.full((12, 10), 0.02, np.float32)
    slopes, rows = torch.tensor([0.4, -0.7]), np.array([1, 5, 11])
    found = cost_volume.disagreements(light, slopes, spread)
    torch.testing.assert_close(cost_volume.disagreements(light, slopes, spread, rows), found[:, rows])


@pytest.mark.parametrize("contrast", [0.2, 1.0, 30.0])
def test_views_that_show_something_else_are_counted_not_weighed(contrast):
    views = torch.full((5, 5, 1, 8, 8), 0.5)
    views[:, 3:] += contrast  # ten of 25
    found = cost_volume.disagreements(of(views), torch.zeros(1), np.full((8, 8), 1e-6, np.float32))
    assert float((found - 10 / 25).abs().max()) < 1e-3


@pytest.mark.parametrize("deviation", [0.003, 0.02])
def test_noise_is_found_but_for_what_interpolation_averages_out(deviation):
    views = shifted_views(neighbours.smoothed(texture(1, 64, 72), 1.5), 0.3, (5, 5)).float()
    noisy = views + deviation * torch.randn(views.shape, generator=torch.Generator().manual_seed(2))
    found = cost_volume.noise(of(noisy), torch.linspace(-0.5, 0.5, 21))
    assert 0.6 * deviation < found < 1.1 * deviation


def test_the_spread_grows_with_noise_and_with_steepness():
    light = of(torch.rand(3, 3, 1, 16, 16))
    flat = of(torch.full((3, 3, 1, 16, 16), 0.4))
    assert bool((cost_volume.spread(light, 0.02) > cost_volume.spread(light, 0.01)).all())
    assert bool((cost_volume.spread(light, 0.0) > cost_volume.spread(flat, 0.0)).all())


def test_a_ramp_has_its_slope_squared_as_steepness():
    ramp = 0.02 * torch.arange(20.0) + 0.01 * torch.arange(18.0)[:, None]
    torch.testing.assert_close(cost_volume.steepness(ramp), torch.full((18, 20), 5e-4), atol=1e-7, rtol=0)
