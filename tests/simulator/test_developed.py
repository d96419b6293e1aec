"""A developed truth has the brightness and colours of views that have no other effects."""

import dataclasses

import torch

from lfref.simulator.developed import developed
from lfref.simulator.effects.mosaic import Mosaic
from lfref.simulator.effects.noise import Noise
from lfref.simulator.effects.response import Clipping, Exposure, Quantisation, ToneCurve, WhiteBalance
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.effects.vignetting import Vignetting
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.simulate import simulate
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Checker

SENSOR = Sensor(
    exposure=Exposure(1.5),
    clipping=Clipping(),
    white_balance=WhiteBalance((0.5, 1.0, 0.8)),
    tone_curve=ToneCurve("srgb"),
)
SCENE = Scene(Camera((3, 3), (20, 24)), (Surface(Plane(0.0), Checker(9.0)),), sensor=SENSOR)


def test_a_plane_in_focus_is_developed_into_its_views():
    found = simulate(SCENE, slopes=[0.0])
    expected = found.views[1, 1]
    torch.testing.assert_close(developed(found.truth[0], SENSOR), expected, atol=2e-3, rtol=0)
    assert float((found.truth[0] - expected).abs().max()) > 0.1


def test_what_lies_beyond_the_sensors_limit_is_clipped_before_it_is_balanced():
    white = developed(torch.full((2, 3, 4, 4), 3.0), dataclasses.replace(SENSOR, tone_curve=None))
    torch.testing.assert_close(white[0, :, 0, 0], torch.tensor([0.5, 1.0, 0.8]))


def test_defects_of_the_views_leave_a_truth_alone():
    spoilt = Sensor(
        vignetting=Vignetting(0.5, 0.5), mosaic=Mosaic(), noise=Noise(0.01, 0.01), quantisation=Quantisation(1)
    )
    truth = torch.rand(2, 3, 6, 7) * 4
    assert torch.equal(developed(truth, spoilt), truth)


def test_decoded_pictures_lack_the_tone_curve_alone():
    truth = torch.rand(2, 3, 6, 7)
    decoded = SENSOR.encoding.decode(developed(truth, SENSOR))
    torch.testing.assert_close(decoded, developed(truth, dataclasses.replace(SENSOR, tone_curve=None)))
    assert Sensor().encoding.decode(truth) is truth
