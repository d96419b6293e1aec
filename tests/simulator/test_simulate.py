"""Simulations: only the requested outputs run, planned equals forced, finer pixels agree with coarse ones."""

import dataclasses

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lfref.errors import InputError
from lfref.simulator import materials, mattes, painting, sim30, surfaces, textures
from lfref.simulator.effects.optics import Vignetting
from lfref.simulator.effects.recording import Clipping, Exposure, Mosaic, Noise, Quantisation, ToneCurve, WhiteBalance
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.materials import Emissive
from lfref.simulator.mattes import Disc, Twigs
from lfref.simulator.scene import Camera, Light, Scene, Surface
from lfref.simulator.simulate import OUTPUTS, PAPER, Simulation, developed, finer, simulate
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Checker, Flat
from tests.simulator import drawing

CAMERA = Camera(grid=(3, 3), size=(24, 30))
SLOPES = [-0.5, 0.0, 0.5]
CARDS = Scene(
    CAMERA,
    (Surface(Plane(-0.5), Flat((0.2, 0.3, 0.4))), Surface(Plane(0.5, (0.01, 0.0)), Flat((0.8, 0.1, 0.1)), Disc(7))),
)


def random_scene(seed: int, **more: object) -> Scene:
    scene = drawing.random_scene(seed, CAMERA)
    return dataclasses.replace(scene, **more)


def test_a_name_is_no_scene():
    with pytest.raises(InputError, match=r"must be a Scene; got 'plane'; take one of lfref\.simulator\.sim30"):
        simulate("plane")


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
    monkeypatch.setattr(
        painting,
        "passes",
        lambda scene, reach, force: reaches.append(reach) or passes(scene, reach, force),
    )
    return reaches


def test_one_painting_serves_views_and_truths_within_reach(painted):
    scene = random_scene(1)
    simulation = Simulation(scene, reach=0.5)
    views = simulation.run(["views"]).views
    result = [simulation.run(["truth"], slopes).truth for slopes in (SLOPES, [0.3])]
    assert painted == [0.5]
    torch.testing.assert_close(views, simulate(scene, outputs=["views"]).views, atol=1e-6, rtol=0)
    for truths, slopes in zip(result, (SLOPES, [0.3]), strict=True):
        torch.testing.assert_close(truths, simulate(scene, outputs=["truth"], slopes=slopes).truth, atol=1e-6, rtol=0)


def test_a_slope_beyond_the_reach_has_it_painted_again(painted):
    scene = random_scene(2)
    simulation = Simulation(scene)
    simulation.run(["views"])
    beyond = simulation.run(["truth"], SLOPES)
    simulation.run(["truth"], [-0.2])
    assert painted == [0.0, 0.5]
    assert torch.equal(beyond.truth, simulate(scene, outputs=["truth"], slopes=SLOPES).truth)


@pytest.mark.slow
@settings(deadline=None, max_examples=30, suppress_health_check=list(HealthCheck))
@given(drawing.SCENES, drawing.SENSORS, st.sampled_from(["square", "disc"]))
def test_planned_equals_forced(scene, sensor, aperture):
    camera = dataclasses.replace(scene.camera, aperture=aperture)
    assert_planned_equals_forced(dataclasses.replace(scene, camera=camera, sensor=sensor))


@pytest.mark.parametrize("seed", range(4))
def test_planned_equals_forced_also_in_few_scenes(seed):
    sensor = Sensor(exposure=Exposure(1.0 + seed % 2), noise=Noise(0.001, 1e-4) if seed > 1 else None)
    assert_planned_equals_forced(random_scene(seed, sensor=sensor))


def test_a_black_mirror_of_a_hidden_surface_changes_no_layers():
    """The forced mirror of a transparent surface lies far from focus; twigs outside of the picture stay unseen."""
    black, white = Flat((0.0, 0.0, 0.0)), Flat((1.0, 1.0, 1.0))
    surfaces = (
        Surface(Plane(0.0), black, opacity=0.0),
        Surface(Plane(1.0, (0.0, 0.0625)), black, opacity=0.0),
        Surface(Plane(0.0), white, Disc(1.0), Emissive(1.0)),
        Surface(Plane(0.0), black, Twigs(1.0, 1.0, 0, 0.0, (0.0, 19.0), 0)),
    )
    assert_planned_equals_forced(Scene(drawing.CAMERA, surfaces, Light(0.0)))


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


def test_a_seed_changes_noise_and_textures():
    scene = random_scene(5, sensor=Sensor(noise=Noise(0.001, 1e-4)))
    first, again, other = (simulate(scene, seed, ["views"]).views for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_without_slopes_the_truth_has_the_papers_planes():
    slopes = simulate(CARDS, outputs=["disparity"]).slopes
    torch.testing.assert_close(slopes, 1 - 8 / torch.arange(1, 17, dtype=torch.float64))
    assert PAPER.alphas[0] == 0.125


@pytest.mark.parametrize("outputs", [[], ["pictures"]])
def test_outputs_that_do_not_exist_are_refused(outputs):
    with pytest.raises(InputError, match="outputs must be some of views, truth, disparity, all_in_focus, masks"):
        simulate(CARDS, outputs=outputs)


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


@pytest.mark.parametrize("name", ["floor", "leaves"])
def test_scenes_without_random_textures_look_the_same_with_more_samples(name):
    (scene,) = sim30.scenes(name, Camera((3, 3), (48, 64))).scenes
    plain = textures.Stripes(30, angle=20)
    scene = dataclasses.replace(
        scene, surfaces=tuple(dataclasses.replace(surface, texture=plain) for surface in scene.surfaces)
    )
    more = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, samples=3))
    one, several = (simulate(each, 0, OUTPUTS, SLOPES) for each in (scene, more))
    for output in ("views", "truth", "all_in_focus"):
        difference = getattr(one, output) - getattr(several, output)
        assert float(difference.square().mean()) < 10**-2.8
    agrees = (one.disparity - several.disparity).abs() < 0.02
    assert float(agrees.float().mean()) > 0.9


def test_stripes_finer_than_half_a_cycle_a_pixel_are_seen_through_more_samples():
    fine = Scene(Camera((1, 1), (16, 64)), (Surface(surfaces.Plane(0.0), textures.Stripes(1.7)),))
    contrasts = [
        float(simulate(dataclasses.replace(fine, camera=camera), 0, ["views"]).views.std())
        for camera in (fine.camera, dataclasses.replace(fine.camera, samples=4))
    ]
    assert contrasts[0] == 0
    assert contrasts[1] > 0.05


def test_every_part_of_a_scene_names_those_of_its_fields_that_are_lengths():
    bases = mattes.Outline, materials.Material, textures.Texture, surfaces.Geometry
    parts = [part for base in bases for part in subclasses(base) if not part.__name__.startswith("_")]
    assert len(parts) == 19
    for part in [*parts, Surface]:
        assert set(part.lengths) <= {field.name for field in dataclasses.fields(part)}


def subclasses(base):
    return [part for child in base.__subclasses__() for part in (child, *subclasses(child))]


def test_pixels_of_one_sample_cannot_be_divided():
    (scene,) = sim30.scenes("plane").scenes
    assert finer(scene, 1) is scene
    with pytest.raises(InputError, match="samples must be a multiple of 2"):
        finer(scene, 2)


@pytest.mark.parametrize("samples", [0, 1.5, 9])
def test_samples_that_no_camera_takes_are_refused(samples):
    with pytest.raises(InputError, match="samples must be a whole number"):
        Camera(samples=samples)


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


def test_what_lies_beyond_the_sensors_limit_is_clipped_before_it_is_balanced():
    white = developed(torch.full((2, 3, 4, 4), 3.0), dataclasses.replace(SENSOR, tone_curve=None))
    torch.testing.assert_close(white[0, :, 0, 0], torch.tensor([0.5, 1.0, 0.8]))


def test_defects_of_the_views_leave_a_truth_alone():
    spoilt = Sensor(
        vignetting=Vignetting(0.5, 0.5), mosaic=Mosaic(), noise=Noise(0.01, 0.01), quantisation=Quantisation(1)
    )
    truth = torch.rand(2, 3, 6, 7) * 4
    assert torch.equal(developed(truth, spoilt), truth)


def test_views_alone_need_no_planes_that_fit_them():
    scene = Scene(Camera((15, 15), (20, 24)), (Surface(Plane(0.0), Flat((0.5, 0.5, 0.5))),))
    assert simulate(scene, outputs=("views",)).views.shape == (15, 15, 3, 20, 24)
    with pytest.raises(InputError, match="less than half the height"):
        simulate(scene)
