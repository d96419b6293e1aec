"""Axes of views: a reversed one is told on scenes of all kinds, and never where it is not."""

import pytest
import torch

from lfref.data.field_sources import SimulatedSource
from lfref.refocus.focus import slope_range
from lfref.refocus.focus.slope_range import reduce_views
from lfref.simulator import sim30
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes
from lfref.simulator.simulate import simulate
from tests.refocus.conftest import shifted_views, texture


@pytest.mark.parametrize("name", ["plane", "deep", "vignetting", "everything"])
def test_one_reversed_axis_is_told(name):
    views = simulate(sim30.SCENES[name], outputs=["views"]).views
    assert [slope_range.seems_reversed(reduce_views(each)) for each in (views, views.flip(0), views.flip(1))] == [
        False,
        True,
        True,
    ]


def test_random_scenes_in_our_order_do_not_seem_reversed():
    source = SimulatedSource(8, 0, RandomScenes(Camera((5, 5), (64, 72))))
    scenes = [source.field(index).views for index in range(len(source))]
    assert not any(slope_range.seems_reversed(reduce_views(views)) for views in scenes)
    told = [slope_range.seems_reversed(reduce_views(views.flip(0))) for views in scenes]
    assert sum(told) >= 6  # where next to nothing moves, nothing is said


def test_both_reversed_are_as_good_as_none():
    views = simulate(sim30.SCENES["shards"], outputs=["views"]).views.flip((0, 1))
    assert slope_range.axis_correlation(reduce_views(views)) > 0.8


def test_disparities_of_many_pixels_do_not_hide_it():
    views = shifted_views(texture(1, 96, 120), -3.0, (5, 5))
    assert slope_range.seems_reversed(reduce_views(views.flip(1)))
    assert not slope_range.seems_reversed(reduce_views(views))


@pytest.mark.parametrize(
    "views",
    [
        torch.rand(5, 5, 3, 64, 64),
        torch.rand(1, 7, 3, 64, 64),
        torch.zeros(3, 3, 1, 64, 64),
        torch.rand(3, 3, 1, 1, 9),
        torch.rand(34, 34, 1, 32, 32),
    ],
)
def test_where_nothing_is_known_nothing_is_said(views):
    assert slope_range.axis_correlation(reduce_views(views)) == 0


def test_a_plane_at_slope_0_fits_either_way():
    views = texture(1, 96, 120).expand(5, 5, 1, 96, 120)
    assert not slope_range.seems_reversed(reduce_views(views.flip(0)))


def test_the_real_capture_is_stored_as_we_count(lytro):
    from lfref.io.read import read

    views = read(lytro, encoding="linear").views
    assert slope_range.axis_correlation(reduce_views(views)) > 0.8
    assert slope_range.axis_correlation(reduce_views(views.flip(0))) < -0.8
