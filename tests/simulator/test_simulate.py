import dataclasses

import pytest
import torch

from lfref.errors import InputError
from lfref.simulator import bitmaps, render, scenes, truth
from lfref.simulator.effects.exposure import Exposure
from lfref.simulator.effects.noise import Noise
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.simulate import simulate
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Flat

CAMERA = Camera(grid=(3, 3), size=(24, 30))
SLOPES = [-0.5, 0.0, 0.5]
CARDS = Scene(
    CAMERA,
    (
        Surface(Plane(-0.5), Flat((0.2, 0.3, 0.4))),
        Surface(Plane(0.5, (0.01, 0.0)), Flat((0.8, 0.1, 0.1)), Disc(7)),
    ),
)


def random_scene(seed: int, **more: object) -> Scene:
    scene = scenes.random_scene(torch.Generator().manual_seed(seed), CAMERA)
    return dataclasses.replace(scene, **more)


def test_only_what_is_asked_for_is_made():
    found = simulate(CARDS, outputs=["disparity"])
    assert found.views is None
    assert found.truth is None
    assert {row.name for row in found.rows if row.state == "run"} == {"paint", "find disparity"}


def test_views_and_truth_are_those_of_the_painted_layers():
    scene = random_scene(1)
    found = simulate(scene, slopes=SLOPES)
    layers = bitmaps.paint(scene, reach=0.5)
    torch.testing.assert_close(found.views, render.views(layers, CAMERA))
    torch.testing.assert_close(found.truth, truth.stack(layers, CAMERA, SLOPES))


def test_effects_that_are_off_are_skipped_for_a_reason():
    rows = {row.name: row for row in simulate(CARDS, outputs=["views"]).rows}
    assert rows["noise"].state == "skipped"
    assert rows["noise"].why
    assert rows["noise"].milliseconds is None
    assert rows["view"].milliseconds > 0


@pytest.mark.parametrize("seed", range(4))
def test_planned_equals_forced(seed):
    sensor = Sensor(exposure=Exposure(1.0 + seed % 2), noise=Noise(0.001, 1e-4) if seed > 1 else None)
    scene = random_scene(seed, sensor=sensor)
    planned, forced = (simulate(scene, outputs=["views"], slopes=SLOPES, force=force) for force in (False, True))
    torch.testing.assert_close(planned.views, forced.views, atol=1e-6, rtol=0)
    assert sum(row.state == "run" for row in forced.rows) > sum(row.state == "run" for row in planned.rows)


def test_disparity_is_that_of_the_nearest_surface_shown():
    disparity = simulate(CARDS, outputs=["disparity"]).disparity
    x = torch.arange(30) - 14.5
    torch.testing.assert_close(disparity[12, 10:20], 0.5 + 0.01 * x[10:20])
    assert disparity[0, 0] == -0.5


def test_a_seed_changes_noise_and_textures():
    scene = random_scene(5, sensor=Sensor(noise=Noise(0.001, 1e-4)))
    first, again, other = (simulate(scene, seed, ["views"]).views for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@pytest.mark.parametrize("outputs", [[], ["pictures"]])
def test_outputs_that_do_not_exist_are_refused(outputs):
    with pytest.raises(InputError, match="outputs must be some of views, truth, disparity"):
        simulate(CARDS, outputs=outputs)


def test_slopes_that_the_views_are_too_small_for_are_refused():
    with pytest.raises(InputError, match="less than half"):
        simulate(CARDS, slopes=[20.0])
