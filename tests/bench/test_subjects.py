"""Subjects: what they are judged by is what a lens records, developed like the views, through the same aperture."""

import dataclasses

import pytest
import torch

from lfref.bench import subjects
from lfref.captures.correct import correct
from lfref.encoding import SRGB
from lfref.functional.psnr import psnr
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.nets.refnet import RefNet
from lfref.refocus import apertures
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.operators import OperatorRefocuser
from lfref.simulator import sim30
from lfref.simulator.developed import developed
from lfref.simulator.effects.noise import Noise
from lfref.simulator.effects.response import Exposure, ToneCurve
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.simulate import simulate
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Checker, Flat
from tests.captures import displaced

CPU = torch.device("cpu")
SLOPES = torch.tensor([-1.0, 0.0], dtype=torch.float64)
SENSOR = Sensor(exposure=Exposure(0.5), noise=Noise(1e-3), tone_curve=ToneCurve("srgb"))
SURFACES = (Surface(Plane(0.0), Checker(9.0)), Surface(Plane(0.5), Flat((0.9, 0.8, 0.1)), Disc(3)))
CLEAN = Scene(Camera((3, 3), (20, 24)), SURFACES, name="clean")
NOISY = dataclasses.replace(CLEAN, sensor=SENSOR, name="noisy")
EXACT = OperatorRefocuser("exact", exact_fourier)


def test_a_scene_is_judged_without_its_sensor_and_one_that_has_a_sensor_also_with_it():
    found = list(subjects.simulated([CLEAN, NOISY], SLOPES, CPU))
    assert [(each.kind, each.light.name) for each in found] == [
        ("ideal", "clean"), ("ideal", "noisy"), ("sensor", "noisy"),
    ]  # fmt: skip
    assert {each.reference for each in found} == {"truth"}
    made = simulate(CLEAN, slopes=SLOPES)
    for each in found[:2]:
        assert torch.equal(each.light.views, made.views)
        assert torch.equal(each.truth, made.truth)
    views = simulate(NOISY, outputs=["views"], slopes=[0.0]).views
    assert torch.equal(found[2].light.views, SENSOR.encoding.decode(views))
    torch.testing.assert_close(found[2].shown(found[2].truth).stack, developed(made.truth, SENSOR))
    assert torch.equal(found[2].shown(found[2].truth).linear, found[2].truth)


def test_views_that_are_left_encoded_are_shown_as_they_are():
    samples = torch.rand(2, 3, 4, 5)
    light = LightField(torch.rand(3, 3, 3, 4, 5), is_linear=False)
    shown = subjects.Subject("sensor", light, samples, "truth", encoding=SRGB).shown(samples)
    assert torch.equal(shown.stack, samples)
    assert torch.equal(shown.linear, SRGB.decode(samples))


@pytest.mark.parametrize(("correction", "least"), [("auto", 15.0), ("white", 20.0)])
def test_a_scene_whose_sensor_spoils_it_is_also_judged_put_right(correction, least):
    found = list(subjects.simulated([sim30.SCENES["vignetting"]], SLOPES, CPU, correction))
    assert [each.kind for each in found] == ["ideal", "sensor", "corrected"]
    spoilt, mended = (psnr(each.stack(EXACT, SLOPES), each.truth) for each in found[1:])
    assert float((mended - spoilt).min()) > least


def test_operators_look_at_a_disc_scene_through_a_disc():
    camera = dataclasses.replace(CLEAN.camera, aperture="disc", grid=(5, 5))
    (disc,) = subjects.simulated([dataclasses.replace(CLEAN, camera=camera)], SLOPES, CPU)
    weights = apertures.disc((5, 5))
    through = disc.stack(EXACT, SLOPES)
    torch.testing.assert_close(through, exact_fourier(disc.light.views, SLOPES, weights=weights))
    assert float(psnr(through[0], disc.truth[0])) > 1 + float(psnr(EXACT(disc.light, SLOPES)[0], disc.truth[0]))
    small = OperatorRefocuser("small", shift_and_sum, lambda grid: apertures.disc(grid, 3))
    torch.testing.assert_close(disc.stack(small, SLOPES), small(disc.light, SLOPES))


def test_networks_are_judged_as_they_are():
    network = NetworkRefocuser(RefNet(n_planes=2, grid=(3, 3), widths=(4,), stem_width=4), FocalPlanes(SLOPES))
    subject = subjects.Subject("ideal", LightField(torch.rand(3, 3, 3, 20, 24)), torch.rand(2), "truth", apertures.disc)
    torch.testing.assert_close(subject.stack(network, SLOPES), network(subject.light))


def test_light_fields_of_which_nothing_is_known_are_judged_by_exact_refocusing():
    fields = [LightField(torch.rand(3, 3, 3, 16, 18), name) for name in ("a", "b")]
    found = list(subjects.given(fields, SLOPES))
    assert [(each.kind, each.light, each.reference) for each in found] == [
        ("given", field, "exact_fourier") for field in fields
    ]
    torch.testing.assert_close(found[1].truth, exact_fourier(fields[1].views, SLOPES))


@pytest.mark.parametrize("aperture", ["square", "disc"])
def test_every_aperture_of_a_camera_has_weights(aperture):
    assert Camera(aperture=aperture).aperture in subjects.APERTURES


def test_put_right_cameras_stay_on_the_grid_that_all_methods_can_read():
    field = displaced.stretched("leaves", 1.2)
    assert correct(field)[0].positions is not None
    assert subjects.put_right(sim30.SCENES["leaves"], field).positions is None
