"""The cost volume: a slow reference, votes that do not depend on contrast, measured noise, the views that are read."""

import math

import numpy as np
import pytest
import torch

from lfref.errors import InputError
from lfref.functional import splines
from lfref.refocus.disparity import cost_volume
from lfref.refocus.disparity.cost_volume import grey_of, grey_views


def of(views):
    aperture = torch.ones(views.shape[:2])
    return grey_views(grey_of(views, aperture), aperture)


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
    views = zip(light.samples.numpy(), light.positions.tolist(), strict=True)
    values = [read(view, y + slope * v, x + slope * u) for view, (v, u) in views]
    first = np.mean([values[k] for k in light.middle if values[k] is not None])
    present = np.array([value for value in values if value is not None])
    weights = spread / (spread + (present - first) ** 2)
    squares = (present - (weights * present).sum() / weights.sum()) ** 2
    return (squares / (squares + spread)).mean()


@pytest.mark.parametrize("grid", [(3, 3), (2, 4), (1, 5)])
def test_shares_are_those_of_a_slow_loop(grid):
    light = of(torch.rand(*grid, 1, 9, 11))
    spread = 0.01 + 0.1 * torch.rand(9, 11)
    slopes = torch.tensor([-1.3, 0.0, 0.37, 1.0], dtype=torch.float64)
    shares = cost_volume.disagreements(light, slopes, spread)
    expected = [
        [[slow_share(light, s, float(spread[y, x]), y, x) for x in range(11)] for y in range(9)]
        for s in slopes.tolist()
    ]
    np.testing.assert_allclose(shares, np.array(expected), atol=2e-5)
    rows = torch.tensor([1, 5, 8])
    torch.testing.assert_close(cost_volume.disagreements(light, slopes, spread, rows), shares[:, rows])
    for chosen in (None, rows):
        compiled, by_torch = (
            disagreements(light, slopes, spread, chosen)
            for disagreements in (cost_volume.disagreements, cost_volume._disagreements)
        )
        torch.testing.assert_close(by_torch, compiled, atol=2e-5, rtol=0)


@pytest.mark.parametrize("contrast", [0.2, 30.0])
def test_views_that_show_something_else_are_counted_not_weighed(contrast):
    views = torch.full((5, 5, 1, 8, 8), 0.5)
    views[:, 3:] += contrast  # ten of 25
    shares = cost_volume.disagreements(of(views), torch.zeros(1, dtype=torch.float64), torch.full((8, 8), 1e-6))
    assert float((shares - 10 / 25).abs().max()) < 1e-3


def test_detail_keeps_fine_texture_and_little_of_shading_and_steps():
    column = torch.arange(64)
    fine = 0.51 + 0.002 * (-1.0) ** column
    ramp, step = 0.3 + 0.004 * column, 0.3 + 0.4 * (column >= 32)
    kept = []
    for light in (fine, ramp, step):
        views = light.float().square().expand(3, 3, 1, 32, 64)  # `details` takes roots of light
        detail = cost_volume.details(of(views), torch.zeros(1, dtype=torch.float64)).samples[0, 16]
        kept.append((detail[8:-8].max() - detail[8:-8].min()) / float(light[8:-8].max() - light[8:-8].min()))
    assert kept[0] > 0.85
    np.testing.assert_allclose(kept[1:], 1 - cost_volume.SHADING, rtol=0.05)


def test_views_of_weight_0_are_not_read_and_others_must_be_finite():
    views, aperture = torch.rand(3, 3, 1, 5, 6), torch.ones(3, 3)
    views[1, 1], aperture[1, 1] = math.nan, 0
    light = grey_views(grey_of(views, aperture), aperture)
    # The four beside the missing one.
    assert sorted(map(tuple, light.positions[light.middle].tolist())) == [(-1, 0), (0, -1), (0, 1), (1, 0)]
    with pytest.raises(InputError, match="finite"):
        of(views)
    with pytest.raises(InputError, match="more than one view"):
        grey_views(torch.rand(2, 2, 5, 6), torch.tensor([[1.0, 0], [0, 0]]))
