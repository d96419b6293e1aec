"""The range of slopes: covers nearly all of a scene, is hardly wider, and is nothing where nothing is seen."""

import dataclasses

import pytest
import torch

from lfref.refocus.focus.slope_range import (
    CoarseDisparity,
    disparity_of_reduced,
    on_surfaces,
    reduce_views,
    slope_range,
)
from lfref.simulator import sim30
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.simulate import simulate

NOT_ON_SURFACES = ("gloss", "apple", "window", "mirror", "lamps", "veil")
"""Highlights, reflections, what glass and veils let through: seen at other disparities than those of the surfaces."""
TOLERANCE = 0.02  # pixels per view step: of a plane facing the camera the range is a single number


def range_of(views: torch.Tensor) -> tuple[float, float]:
    found = slope_range(disparity_of_reduced(reduce_views(views)))
    assert found is not None
    return found


def held_against(truth: torch.Tensor, views: torch.Tensor) -> tuple[float, float]:
    """Share of the true disparities that the range covers, and how many times it is as wide as their 98 %."""
    low, high = range_of(views)
    ends = truth.flatten().quantile(torch.tensor([0.01, 0.99]))
    covered = ((truth >= low - TOLERANCE) & (truth <= high + TOLERANCE)).float().mean()
    return float(covered), (high - low) / max(float(ends[1] - ends[0]), 0.1)


@pytest.mark.parametrize("name", ["shards", "discs", "crossing", "dome", "deep", "everything"])
def test_the_range_covers_a_scene_and_is_hardly_wider(name):
    made = simulate(sim30.SCENES[name], outputs=["views", "disparity"])
    covered, width = held_against(made.disparity, made.views)
    assert covered > 0.98
    assert width < 1.3


@pytest.mark.slow
@pytest.mark.parametrize("version", sim30.VERSIONS)
@pytest.mark.parametrize("name", [name for name in sim30.SCENES if name not in NOT_ON_SURFACES])
def test_of_all_scenes_of_surfaces_with_and_without_their_sensors(name, version):
    scene = sim30.VERSIONS[version][name]
    for each in (scene, dataclasses.replace(scene, sensor=Sensor())):
        made = simulate(each, outputs=["views", "disparity"])
        covered, width = held_against(made.disparity, made.views)
        assert covered > 0.98
        assert width < 1.3


def test_strays_and_what_is_unsure_are_left_out():
    disparity = torch.linspace(-1, 1, 100).expand(100, 100).clone()
    disparity[50, 50] = 30.0
    confidence = torch.ones(100, 100)
    confidence[:, :25] = 0.1
    low, high = slope_range(CoarseDisparity(disparity, confidence, 1))
    assert low == pytest.approx(-0.5, abs=0.1)
    assert high == pytest.approx(1.0, abs=0.1)


def test_a_surface_is_where_neighbours_agree():
    disparity = torch.zeros(9, 9)
    disparity[4, 4] = 1.0
    assert not on_surfaces(CoarseDisparity(disparity, torch.ones(9, 9), 1))[4, 4]
    # The same difference is none where pixels are reduced ten times as much.
    assert on_surfaces(CoarseDisparity(disparity, torch.ones(9, 9), 20))[4, 4]


@pytest.mark.parametrize(
    "views",
    [torch.full((5, 5, 3, 40, 50), 0.3), torch.rand(1, 1, 3, 40, 50), torch.full((3, 3, 1, 40, 50), torch.nan)],
)
def test_where_nothing_is_seen_there_is_no_range(views):
    assert slope_range(disparity_of_reduced(reduce_views(views))) is None


def test_noise_alone_has_no_range():
    assert slope_range(disparity_of_reduced(reduce_views(torch.rand(7, 7, 3, 128, 192)))) is None
