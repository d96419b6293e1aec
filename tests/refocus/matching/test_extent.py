"""Between which disparities to look: all that there is lies within, smooth surfaces too."""

import pytest
import torch

from lfref.refocus.disparity import disparity_map
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate

EVEN = torch.full((7, 7), 1 / 49, dtype=torch.float64)


@pytest.mark.parametrize("name", ["leaves", "twigs", "deep", "wall"])
def test_what_the_central_view_shows_lies_within(name):
    made = simulate(sim30.SCENES[name], outputs=["views", "disparity"])
    low, high = disparity_map.estimate_range(made.views, EVEN)
    inside = (made.disparity > low) & (made.disparity < high)
    assert float(inside.float().mean()) > 0.98
    assert high - low < 1.4 * float(made.disparity.max() - made.disparity.min()) + 0.6


@pytest.mark.parametrize("size", [(8, 9), (20, 40)])
@pytest.mark.parametrize("grid", [(2, 2), (7, 7)])
def test_small_views_are_no_error(grid, size):
    low, high = disparity_map.estimate_range(
        torch.rand(*grid, 3, *size), torch.full(grid, 1 / (grid[0] * grid[1])).double()
    )
    assert low <= high
