"""A reversed axis is noticed on scenes with parallax, and nothing is claimed where there is nothing to see."""

import pytest
import torch

from lfref.data.sources import SimulatedSource
from lfref.refocus.focus import view_order
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes


@pytest.fixture(scope="module")
def scenes():
    source = SimulatedSource(4, 0, RandomScenes(Camera((5, 5), (64, 72))))
    return [source.field(index).views for index in range(len(source))]


def test_scenes_in_our_order_do_not_seem_reversed(scenes):
    assert not any(view_order.seems_reversed(views) for views in scenes)


@pytest.mark.parametrize("axis", [0, 1])
def test_one_reversed_axis_is_noticed(scenes, axis):
    assert all(view_order.seems_reversed(views.flip(axis)) for views in scenes)


def test_reversing_both_axes_only_swaps_the_sign_of_the_slope(scenes):
    assert not any(view_order.seems_reversed(views.flip(0, 1)) for views in scenes)


def test_detail_of_the_sharp_order_is_the_larger_one(scenes):
    for views in scenes:
        assert view_order.detail(views) > view_order.MARGIN * view_order.detail(views.flip(0))


def test_detail_of_a_known_texture_is_its_squared_laplacian():
    # All views alike and a slope never 0: of a vertical wave, horizontal shifts cannot be seen by a single column.
    y = torch.arange(40, dtype=torch.float64)
    wave = torch.cos(2 * torch.pi * y / 8)[:, None].expand(1, 5, 1, 40, 40)
    laplacian_gain = 2 - 2 * torch.cos(torch.tensor(2 * torch.pi / 8, dtype=torch.float64))
    expected = float(laplacian_gain**2 / 2)
    assert view_order.detail(wave) == pytest.approx(expected, rel=0.07)


@pytest.mark.parametrize("kind", [torch.zeros, torch.ones, torch.rand])
def test_views_without_parallax_or_structure_do_not_seem_reversed(kind):
    assert not view_order.seems_reversed(kind(5, 5, 1, 64, 64))
    assert not view_order.seems_reversed(kind(1, 1, 1, 64, 64).expand(5, 5, -1, -1, -1))


@pytest.mark.parametrize("shape", [(1, 5, 3, 64, 64), (5, 1, 3, 64, 64), (5, 5, 3, 31, 64), (5, 5, 3, 64, 31)])
def test_too_few_views_or_pixels_to_tell_are_let_pass(shape):
    assert not view_order.seems_reversed(torch.rand(shape))


def test_only_the_centre_of_large_views_is_looked_at():
    views = torch.full((3, 3, 1, 200, 210), 0.5)
    views[..., :20, :] = views[..., -20:, :] = torch.rand(3, 3, 1, 20, 210)
    views[..., :25] = views[..., -25:] = torch.nan
    assert not view_order.seems_reversed(views)
    assert view_order.detail(views[..., 20:180, 25:185]) == 0


def test_many_small_views_are_no_error():
    assert not view_order.seems_reversed(torch.rand(34, 34, 1, 32, 32))
