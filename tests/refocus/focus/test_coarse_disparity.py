"""Disparity at half the size: nearly that of the whole, on any size."""

import pytest
import torch

from lfref.refocus.disparity.disparity_map import coarse_disparity, disparity_map
from tests.refocus.conftest import shifted_views, texture


@pytest.mark.parametrize("size", [(256, 270), (257, 263), (63, 81)])
@pytest.mark.parametrize("ends", [(None, None), (-1.0, 1.0)])
def test_it_is_the_slope_at_which_views_agree(size, ends):
    views = shifted_views(texture(3, *size), 0.4, (5, 5)).float()
    found = coarse_disparity(views, *ends)
    assert found.shape == size
    assert float((found - 0.4).abs()[8:-8, 8:-8].median()) < 0.06


def test_it_is_alike_in_squares_of_two_by_two():
    found = coarse_disparity(torch.rand(3, 3, 3, 256, 258))
    assert torch.equal(found[::2], found[1::2])
    assert torch.equal(found[:, ::2], found[:, 1::2])


def test_small_views_are_looked_at_whole():
    views = torch.rand(9, 9, 3, 21, 23)
    assert torch.equal(coarse_disparity(views, -1.0, 1.0), disparity_map(views, -1.0, 1.0).disparity)
