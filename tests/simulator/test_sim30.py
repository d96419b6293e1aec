"""sim30: thirty scenes that stay as they are, and span what the simulator knows."""

import dataclasses
import hashlib

import pytest

from lfref.errors import InputError
from lfref.geometry import checked_slopes, planes_at_alphas
from lfref.simulator import sim30
from lfref.simulator.effects.sensor import EFFECTS, Sensor
from lfref.simulator.scene import Camera
from lfref.simulator.simulate import PAPER, simulate
from tests.data import test_versions

DEVIATIONS = [
    0.10805, 0.27898, 0.19554, 0.25595, 0.20359, 0.13526, 0.21534, 0.24849, 0.2225, 0.13231, 0.23487, 0.2697,
    0.20192, 0.23489, 0.10808, 0.16016, 0.29416, 0.12572, 0.20138, 0.03246, 0.05206, 0.13461, 0.16103,
    0.18297, 0.22186, 0.27574, 0.15279, 0.20592, 0.09265, 0.1817,
]  # fmt: skip
"""Standard deviation of the views of each scene at VERSION, from a camera of 2 x 2 views of 24 x 36 pixels."""


def test_scenes_that_change_get_another_version():
    # Figures measured on sim30 are comparable between equal versions: who changes a scene changes both.
    assert (sim30.VERSION, sim30.VERSION_2) == ("aa53f9c0373a", "5d1c7b64e9f2")
    descriptions = repr([test_versions.description(scene) for scene in sim30.SCENES.values()])
    assert hashlib.sha256(descriptions.encode()).hexdigest()[:12] == "aa53f9c0373a"
    for scene, expected in zip(sim30.scenes(camera=Camera((2, 2), (24, 36))).scenes, DEVIATIONS, strict=True):
        views = simulate(scene, outputs=["views"], slopes=[0.0]).views
        assert float(views.double().std()) == pytest.approx(expected, abs=2e-5), scene.name


def test_there_are_thirty_of_different_names():
    assert len(sim30.SCENES) == len(sim30.scenes().scenes) == 30
    assert all(scene.name == name for name, scene in sim30.SCENES.items())
    # Without their sensors too: a mean over ideal scenes counts none twice.
    assert len({dataclasses.replace(scene, name="", sensor=Sensor()) for scene in sim30.SCENES.values()}) == 30


def test_every_effect_is_there_and_most_of_them_without_others():
    sensors = [scene.sensor for scene in sim30.SCENES.values()]
    shown = [{type(effect) for effect in vars(sensor).values() if effect} for sensor in sensors]
    assert len(set.union(*shown)) == 11
    assert set.union(*shown) <= set(EFFECTS.values())
    assert sum(len(effects) == 1 for effects in shown) >= 4
    assert sum(not effects for effects in shown) >= 15


def test_the_papers_planes_fit_in_either_convention():
    camera = sim30.CAMERA
    for planes in (PAPER, planes_at_alphas(PAPER.alphas, "parallel")):
        slopes = checked_slopes(planes.slopes, camera.grid, camera.size)
        for scene in sim30.SCENES.values():
            far = min(surface.geometry.disparity_range((1, 1))[0] for surface in scene.surfaces)
            assert far >= min(-3.0, float(slopes.min()))


def test_a_scene_that_does_not_exist_is_refused_by_naming_those_that_do():
    with pytest.raises(InputError, match="sim30 scene must be one of plane, stripes"):
        sim30.scenes("nowhere")


def test_another_camera_looks_at_the_same_scene():
    camera = Camera((3, 3), (20, 30))
    (scene,) = sim30.scenes("twigs", camera).scenes
    assert scene == dataclasses.replace(sim30.SCENES["twigs"], camera=camera)


def test_version_2_has_the_same_scenes_with_detail_that_aliases():
    first, second = sim30.scenes().scenes, sim30.scenes(version=2).scenes
    assert {scene.camera.samples for scene in first} == {1}
    assert {scene.camera.samples for scene in second} == {2}
    same = [dataclasses.replace(scene, camera=one.camera) for one, scene in zip(first, second, strict=True)]
    assert same == [*first]
    with pytest.raises(InputError, match="version of sim30 must be one of 1, 2"):
        sim30.scenes(version=3)
