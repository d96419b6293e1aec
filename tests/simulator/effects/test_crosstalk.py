"""Crosstalk: the 3 x 3 kernel inside, and energy that is neither lost nor made at the edge of the grid."""

import pytest
import torch

from lfref.simulator.effects.optics import Crosstalk

GRIDS = [(5, 5), (1, 4), (2, 3)]


def mix(views, leak):
    return Crosstalk(leak).apply(views, torch.Generator())


def test_a_single_lit_view_shows_the_kernel():
    views = torch.zeros(5, 5, 1, 1, 1, dtype=torch.float64)
    views[2, 2] = 1
    side = torch.tensor([0, 0.1, 0.8, 0.1, 0], dtype=torch.float64)
    torch.testing.assert_close(mix(views, 0.1)[..., 0, 0, 0], side[:, None] * side)


@pytest.mark.parametrize("grid", GRIDS)
def test_energy_is_conserved_at_every_pixel(grid):
    views = torch.rand(*grid, 3, 4, 5, dtype=torch.float64)
    torch.testing.assert_close(mix(views, 0.2).sum((0, 1)), views.sum((0, 1)))


@pytest.mark.parametrize("grid", GRIDS)
def test_what_all_views_share_stays(grid):
    picture = torch.rand(3, 4, 5, dtype=torch.float64)
    views = picture.expand(*grid, 3, 4, 5)
    torch.testing.assert_close(mix(views, 0.3), views)
