"""What hides is nearer: on scenes whose depths are known, in both orders of views, and silent where nothing hides."""

import pytest
import torch

from lfref.refocus.disparity.disparity_map import depth_order, disparity_map
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate


@pytest.fixture(scope="module")
def cards():
    """Cards at three depths, larger disparities nearer, and their true disparity."""
    made = simulate(sim30.SCENES["shards"], 0, ("views", "disparity"))
    return made.views, made.disparity.float()


def test_larger_disparities_are_nearer_in_simulated_fields_and_smaller_ones_with_both_axes_reversed(cards):
    views, disparity = cards
    sure = torch.ones_like(disparity)
    assert depth_order(views, disparity, sure) == 1
    assert depth_order(views.flip(0, 1), -disparity, sure) == -1


def test_a_map_that_was_found_does_as_well(cards):
    found = disparity_map(cards[0])
    assert depth_order(cards[0], *found) == 1


def test_rows_of_views_alone_can_tell(cards):
    views, disparity = cards
    assert depth_order(views[3:4], disparity, torch.ones_like(disparity)) == 1


@pytest.mark.parametrize("kind", ["noise", "flat", "one view"])
def test_where_nothing_hides_anything_nobody_can_tell(kind):
    views = torch.rand(5, 5, 3, 40, 48) if kind != "flat" else torch.full((5, 5, 3, 40, 48), 0.5)
    views = views[:1, :1] if kind == "one view" else views
    disparity = torch.rand(40, 48)
    assert depth_order(views, disparity, torch.zeros(40, 48)) == 0
    assert depth_order(views, torch.full((40, 48), 0.3), torch.ones(40, 48)) == 0
    assert depth_order(views, disparity, torch.ones(40, 48)) == 0


def test_a_tiny_picture_cannot_tell():
    assert depth_order(torch.rand(3, 3, 1, 12, 12), torch.rand(12, 12), torch.ones(12, 12)) == 0
