"""Sources repeat by (seed, epoch, index): a folder is the same every epoch, a simulator is new every epoch."""

from dataclasses import replace

import pytest
import torch

from lfref.captures import view_order
from lfref.captures.correct import correct
from lfref.data.field_sources import FolderSource, SimulatedSource
from lfref.errors import InputError
from lfref.io import read as reader
from lfref.refocus.focus.slope_range import reduce_views
from lfref.simulator import painting, sim30
from lfref.simulator.effects.noise import Noise
from lfref.simulator.effects.response import Clipping, Exposure, ToneCurve
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.effects.vignetting import Vignetting
from lfref.simulator.materials import Emissive
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.scenes import RandomScenes
from lfref.simulator.simulate import Simulation, developed, simulate
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Checker

CAMERA = Camera((3, 2), (10, 12))
SMALL = RandomScenes(CAMERA)
LAMP = Scene(
    CAMERA,
    (Surface(Plane(0.1), Checker(7.0)), Surface(Plane(0.4), Checker(9.0), Disc(3.0), Emissive(5.0))),
    sensor=Sensor(exposure=Exposure(1.4), noise=Noise(1e-3, 1e-4), clipping=Clipping()),
    name="lamp",
)
SLOPES = (-0.5, 0.4)


def test_simulated_fields_have_the_size_and_grid_asked_for():
    field = SimulatedSource(2, 0, SMALL).field(1)
    assert (field.grid, field.size) == ((3, 2), (10, 12))
    assert field.views.dtype == torch.float32
    assert field.name == "simulated_s0_e0_001"


def test_a_simulated_field_is_fixed_by_seed_epoch_and_index():
    def views(seed, epoch, index):
        return SimulatedSource(9, seed, SMALL).field(index, epoch).views

    torch.manual_seed(5)
    reference = views(1, 2, 3)
    torch.manual_seed(6)
    assert torch.equal(reference, views(1, 2, 3))
    others = [views(*key) for key in [(1, 2, 4), (1, 3, 3), (2, 2, 3), (3, 2, 1), (2, 1, 3), (1, 3, 2)]]
    for i, one in enumerate([reference, *others]):
        for two in [reference, *others][:i]:
            assert not torch.allclose(one, two, atol=1e-3)


@pytest.mark.parametrize("seed", [20261121, 2**32 - 1])
def test_any_seed_that_lightning_takes_works(seed):
    assert SimulatedSource(1, seed, SMALL).field(0).size == (10, 12)


def test_simulated_parallax_runs_in_our_order():
    views = SimulatedSource(1, 0, RandomScenes(Camera((5, 5), (64, 64)))).field(0).views
    assert not view_order.find(reduce_views(views)).remedy
    assert view_order.find(reduce_views(views.flip(0))).is_reversed


def test_a_single_scene_is_seen_as_it_is_and_then_with_other_noise():
    source = SimulatedSource(2, 0, LAMP)
    first, second = source.field(0), source.field(1)
    torch.testing.assert_close(first.views, simulate(LAMP, outputs=["views"], slopes=[0.0]).views)
    assert (first.name, second.name) == ("lamp", "lamp_1")
    assert 0 < float((first.views - second.views).abs().max()) < 0.3


def test_views_and_photographs_of_a_bright_scene_are_clipped_alike():
    field = SimulatedSource(1, 0, LAMP).field(0)
    truth = simulate(LAMP, outputs=["truth"], slopes=SLOPES).truth
    photograph = field.photograph(SLOPES)
    assert float(truth.max()) > 3
    assert float(field.views.max()) == float(photograph.max()) == 1.0
    assert torch.equal(photograph, developed(truth, LAMP.sensor))


def test_views_and_photographs_are_linear_light_whatever_curve_the_sensor_has():
    curved = replace(LAMP, sensor=Sensor(tone_curve=ToneCurve("srgb")))
    made, straight = (
        SimulatedSource(1, 0, curved).field(0),
        SimulatedSource(1, 0, replace(LAMP, sensor=Sensor())).field(0),
    )
    torch.testing.assert_close(made.views, straight.views, atol=1e-5, rtol=0)
    torch.testing.assert_close(made.photograph(SLOPES), straight.photograph(SLOPES), atol=1e-5, rtol=0)


def test_fields_are_put_right_where_that_is_asked_for():
    scenes = replace(sim30.SCENES["vignetting"], sensor=Sensor(vignetting=Vignetting(0.6, 0.5)))
    plain, mended = (SimulatedSource(1, 0, scenes, correct=how).field(0) for how in ("none", "auto"))
    expected, _ = correct(plain)
    assert torch.equal(mended.views, expected.views)
    assert torch.equal(mended.weight, expected.weight)
    assert float((mended.views - plain.views).abs().max()) > 0.1


@pytest.fixture
def ran(monkeypatch):
    """Outputs that simulations were asked for, and how often surfaces were painted."""
    asked, run, passes = [], Simulation.run, painting.passes
    monkeypatch.setattr(
        Simulation, "run", lambda self, outputs, *more: asked.append(outputs) or run(self, outputs, *more)
    )
    monkeypatch.setattr(painting, "passes", lambda *args: asked.append("paint") or passes(*args))
    return asked


def test_a_crop_is_photographed_as_the_whole_field_is_and_only_once(ran):
    field = SimulatedSource(1, 0, SMALL).field(0)
    crop, corner = field.crop(2, 3, 6, 7), field.crop(2, 3, 6, 7).crop(1, 2, 3, 4)
    assert torch.equal(crop.views, field.views[..., 2:8, 3:10])
    assert torch.equal(crop.photograph(SLOPES), field.photograph(SLOPES)[..., 2:8, 3:10])
    assert torch.equal(corner.photograph(SLOPES), field.photograph(SLOPES)[..., 3:6, 5:9])
    assert ran == [["views"], "paint", ["truth"], "paint"]


def test_within_reach_a_scene_is_painted_once_for_views_and_photographs(ran):
    field = SimulatedSource(1, 0, SMALL, reach=0.5).field(0)
    photograph = field.photograph(SLOPES)
    assert ran == [["views"], "paint", ["truth"]]
    narrow = SimulatedSource(1, 0, SMALL).field(0)
    torch.testing.assert_close(field.views, narrow.views, atol=1e-6, rtol=0)
    torch.testing.assert_close(photograph, narrow.photograph(SLOPES), atol=1e-6, rtol=0)


def test_fields_that_are_kept_are_rendered_once_and_rounded_to_half_precision(ran, tmp_path):
    first, again = (SimulatedSource(2, 0, SMALL, 0.5, "none", tmp_path, SLOPES).field(1, epoch) for epoch in (3, 5))
    assert ran == [["views"], "paint", ["truth"]]
    assert torch.equal(first.views, again.views)
    rendered = SimulatedSource(2, 0, SMALL, 0.5).field(1)
    assert again.name == rendered.name
    assert torch.equal(again.views, rendered.views.half())
    assert torch.equal(again.photograph(SLOPES), rendered.photograph(SLOPES).half().float())
    crop = again.crop(2, 3, 6, 7)
    assert torch.equal(crop.photograph(SLOPES), again.photograph(SLOPES)[..., 2:8, 3:10])


def test_weights_are_kept_too(tmp_path, monkeypatch):
    source = SimulatedSource(1, 0, RandomScenes(Camera(size=(12, 13))), kept_in=tmp_path)
    rendered = source._rendered(0, 0)
    weight = torch.ones(7, 7, 1, 12, 13)
    weight[0, 0] = 0
    monkeypatch.setattr(source, "_rendered", lambda index, epoch: replace(rendered, weight=weight))
    for field in (source.field(0), source.field(0)):
        torch.testing.assert_close(field.crop(0, 0, 8, 9).weight.float(), weight[..., :8, :9])


def test_scenes_or_settings_that_differ_are_kept_apart(tmp_path):
    def folder(seed=0, scenes=SMALL, reach=0.5, correct="none", planes=SLOPES):
        return SimulatedSource(2, seed, scenes, reach, correct, tmp_path, planes).folder

    others = {"seed": 1, "scenes": LAMP, "reach": 0.0, "correct": "auto", "planes": ()}
    cameras = [replace(SMALL.camera, **{name: value}) for name, value in (("samples", 2), ("truth_error", 1e-3))]
    folders = [folder(), *(folder(**{name: value}) for name, value in others.items())]
    folders += [folder(scenes=replace(SMALL, camera=camera)) for camera in cameras]
    assert len(set(folders)) == len(folders)
    assert folder() == folders[0]


def test_a_field_without_its_views_is_rendered_again(ran, tmp_path):
    source = SimulatedSource(1, 0, SMALL, 0.5, "none", tmp_path, SLOPES)
    source.field(0)
    (source.folder / "00000.npy").unlink()  # a kill came between the truth and the views
    assert torch.equal(source.field(0).views, SimulatedSource(1, 0, SMALL, 0.5).field(0).views.half())
    assert ran.count(["truth"]) == 2


@pytest.mark.parametrize(("n_fields", "seed"), [(0, 0), (1, -1)])
def test_nothing_to_simulate_is_refused(n_fields, seed):
    with pytest.raises(InputError, match="at least one field"):
        SimulatedSource(n_fields, seed, SMALL)


def test_a_folder_source_reads_its_fields_in_order_and_alike_every_epoch(store, tmp_path):
    paths = [store("b", seed=1), store("a", seed=2)]
    source = FolderSource(paths, tmp_path / "cache", {"reverse_u": True})
    assert len(source) == 2
    for index, path in enumerate(paths):
        expected = reader.read(path, reverse_u=True)
        for epoch in (0, 1):
            field = source.field(index, epoch)
            assert field.name == path.name
            assert torch.equal(field.crop(0, 0, 12, 14).light().views, expected.views)
