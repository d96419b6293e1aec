"""Simulations: only the requested outputs run, planned equals forced, finer pixels agree with coarse ones."""

import dataclasses

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lfref.simulator import painting, sim30
from lfref.simulator.effects.recording import Clipping, Exposure, Noise, ToneCurve, WhiteBalance
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.simulate import OUTPUTS, Simulation, developed, finer, simulate
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Checker, Flat
from tests.simulator import drawing

CAMERA = Camera(grid=(3, 3), size=(24, 30))
SLOPES = [-0.5, 0.0, 0.5]
CARDS = Scene(
    CAMERA,
    (Surface(Plane(-0.5), Flat((0.2, 0.3, 0.4))), Surface(Plane(0.5, (0.01, 0.0)), Flat((0.8, 0.1, 0.1)), Disc(7))),
)


def test_only_what_is_asked_for_is_made():
    result = simulate(CARDS, outputs=["disparity"])
    assert result.views is None
    assert result.truth is None
    ran = {row.name for row in result.rows if row.state == "run"}
    assert ran == {"line up", "paint", "outline", "follow rays", "find disparity"}


@pytest.fixture
def painted(monkeypatch):
    """How far the surfaces of scenes were painted, a number for each time that it was done."""
    reaches, passes = [], painting.passes
    monkeypatch.setattr(painting, "passes", lambda scene, reach, force: reaches.append(reach) or passes(scene, reach))
    return reaches


def test_one_painting_serves_views_and_truths_within_reach(painted):
    scene = drawing.random_scene(1, CAMERA)
    simulation = Simulation(scene, reach=0.5)
    views = simulation.run(["views"]).views
    result = [simulation.run(["truth"], slopes).truth for slopes in (SLOPES, [0.3])]
    assert painted == [0.5]
    torch.testing.assert_close(views, simulate(scene, outputs=["views"]).views, atol=1e-6, rtol=0)
    for truths, slopes in zip(result, (SLOPES, [0.3]), strict=True):
        torch.testing.assert_close(truths, simulate(scene, outputs=["truth"], slopes=slopes).truth, atol=1e-6, rtol=0)


@pytest.mark.slow
@settings(deadline=None, max_examples=30, suppress_health_check=list(HealthCheck))
@given(drawing.SCENES, drawing.SENSORS, st.sampled_from(["square", "disc"]))
def test_planned_equals_forced(scene, sensor, aperture):
    camera = dataclasses.replace(scene.camera, aperture=aperture)
    assert_planned_equals_forced(dataclasses.replace(scene, camera=camera, sensor=sensor))


@pytest.mark.parametrize("seed", range(4))
def test_planned_equals_forced_also_in_few_scenes(seed):
    sensor = Sensor(exposure=Exposure(1.0 + seed % 2), noise=Noise(0.001, 1e-4) if seed > 1 else None)
    assert_planned_equals_forced(dataclasses.replace(drawing.random_scene(seed, CAMERA), sensor=sensor))


def assert_planned_equals_forced(scene):
    planned, forced = (simulate(scene, 0, OUTPUTS, slopes=[-2.3, 0.3], force=force) for force in (False, True))
    for output in OUTPUTS:
        result, expected = getattr(planned, output), getattr(forced, output)
        scale = max(1.0, float(expected.abs().max()))
        # Blurs add up to some hundred taps in float32, each of which may round by half a unit of the last place. A plan
        # leaves them out where a surface has one colour.
        torch.testing.assert_close(result, expected, atol=2e-6 * scale, rtol=0)
    # Draw for draw, and not to the nearest step of a quantisation either: the last bit agrees.
    assert torch.equal(planned.views, forced.views)
    n_planned, n_forced = (sum(row.state == "run" for row in result.rows) for result in (planned, forced))
    assert n_forced == len(forced.rows) >= n_planned


SMALL = Camera(grid=(3, 3), size=(24, 30), samples=2)
SLOPES = torch.tensor([-0.5, 0.25])


@pytest.mark.parametrize("name", ["dome", "mirror", "running"])
def test_means_of_finer_pictures_are_the_pictures_of_larger_pixels(name):
    (scene,) = sim30.scenes(name, SMALL).scenes
    coarse = simulate(scene, 0, OUTPUTS, SLOPES)
    fine = simulate(finer(scene, 2), 0, OUTPUTS, 2 * SLOPES)
    for output in ("views", "truth", "all_in_focus", "masks"):
        expected = getattr(fine, output).unfold(-2, 2, 2).unfold(-2, 2, 2).mean((-2, -1))
        # Wider blur in pixels takes more cells, and both truths keep an error below 1e-4 in the root mean square.
        torch.testing.assert_close(getattr(coarse, output), expected, atol=5e-4 if output == "truth" else 1e-6, rtol=0)
    expected = fine.disparity.unfold(-2, 2, 2).unfold(-2, 2, 2).amax((-2, -1)) / 2
    torch.testing.assert_close(coarse.disparity, expected)


SENSOR = Sensor(
    exposure=Exposure(1.5),
    clipping=Clipping(),
    white_balance=WhiteBalance((0.5, 1.0, 0.8)),
    tone_curve=ToneCurve("srgb"),
)
LIT = Scene(Camera((3, 3), (20, 24)), (Surface(Plane(0.0), Checker(9.0)),), sensor=SENSOR)


def test_a_plane_in_focus_is_developed_into_its_views():
    result = simulate(LIT, slopes=[0.0])
    expected = result.views[1, 1]
    torch.testing.assert_close(developed(result.truth[0], SENSOR), expected, atol=2e-3, rtol=0)
    assert float((result.truth[0] - expected).abs().max()) > 0.1
