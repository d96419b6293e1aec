"""sim30: thirty scenes that stay as they are, and span what the simulator knows."""

import dataclasses
import hashlib

import pytest

from lfref.simulator import sim30
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.scene import Camera
from lfref.simulator.simulate import simulate
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
