"""Descriptions of scenes are hashable, also from yaml's lists, and refused where they cannot be rendered."""

import math

import pytest

from lfref.errors import InputError
from lfref.simulator.effects.optics import Chromatic, Crosstalk, Misalignment, Vignetting
from lfref.simulator.effects.recording import Clipping, Exposure, Mosaic, Noise, Quantisation, ToneCurve, WhiteBalance
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.materials import Emissive, Glass, Glossy, Mirror
from lfref.simulator.mattes import Disc, Leaf, Perforated, Polygon, Twigs
from lfref.simulator.scene import Camera, Light, Scene, Surface
from lfref.simulator.scenes import RandomScenes, RandomSensor
from lfref.simulator.simulate import simulate
from lfref.simulator.surfaces import Dome, Plane
from lfref.simulator.textures import Checker, Flat, Picture, Stripes
from lfref.simulator.textures import Noise as Pattern

CAMERA = Camera((3, 5), (20, 31))
SCENE = Scene(CAMERA, (Surface(Plane(0.5), Pattern()),))


def test_lists_are_taken_as_yaml_gives_them():
    matte = Polygon([[0, 0], [4, 0], [0, 4]])
    sensor = Sensor(white_balance=WhiteBalance([1.5, 1, 1.2]))
    scene = Scene(Camera([3, 5], [20, 31]), [Surface(Plane(0.5, [0.0, 0.01]), Flat([1, 0, 0]), matte)], sensor=sensor)
    surface = Surface(Plane(0.5, (0.0, 0.01)), Flat((1, 0, 0)), Polygon(((0, 0), (4, 0), (0, 4))))
    same = Scene(CAMERA, (surface,), sensor=Sensor(white_balance=WhiteBalance((1.5, 1, 1.2))))
    assert scene == same
    assert hash(scene) == hash(same)


def steep(geometry):
    return Scene(CAMERA, (Surface(geometry, Flat()),))


# Half the aperture is 2.5 and 1.5 view steps: 2.5 a + 1.5 b may be 0.5; a dome is steepest, 8 / (3 sqrt 3) of
# bulge / radius, at 1 / sqrt 3 of its radius.
@pytest.mark.parametrize(
    "geometry", [lambda n: Plane(0.0, (0.14 * n, 0.1 * n)), lambda n: Dome(0.0, 60 * n / 8 * 3**1.5 / 8, 60.0)]
)
def test_surfaces_too_steep_for_the_aperture_are_refused(geometry):
    steep(geometry(0.99))
    with pytest.raises(InputError):
        steep(geometry(1.01))


@pytest.mark.parametrize(
    "make",
    [
        # Cameras, surfaces and scenes.
        lambda: Camera((0, 3)), lambda: Camera((3.5, 3)), lambda: Camera(aperture="star"), lambda: Camera(samples=9),
        lambda: Surface(Pattern(), Pattern()), lambda: Surface(Plane(0.0), "noise"),
        lambda: Surface(Plane(0.0), Flat(), opacity=1.5), lambda: Surface(Plane(0.0), Flat(), motion=(1.0,)),
        lambda: Light(-1.0), lambda: Scene(CAMERA, ()), lambda: Scene(CAMERA, (Plane(0.0),)),
        lambda: Sensor(noise=Exposure(2.0)), lambda: simulate(SCENE, outputs=["pictures"]),
        # Shapes, outlines, materials and textures.
        lambda: Plane(math.nan), lambda: Dome(0.0, 1.0, 0.0), lambda: Disc(0.1), lambda: Polygon(((0, 0), (1, 1))),
        lambda: Leaf(5.0, 5.0), lambda: Twigs(10.0, 0.5), lambda: Perforated(10.0, 5.0), lambda: Emissive(-1.0),
        lambda: Glossy(width=0.0), lambda: Mirror(1.5), lambda: Glass(texture="sky"), lambda: Flat((2.0, 0.0, 0.0)),
        lambda: Checker(0.0), lambda: Stripes(8.0, angle=math.nan), lambda: Pattern(exponent=-1.0),
        lambda: Picture("a.png", 0.0),
        # Effects.
        lambda: Chromatic((1, 1)), lambda: Vignetting(10.1), lambda: Misalignment("much"), lambda: Crosstalk(0.34),
        lambda: Mosaic("RGBG"),
        lambda: Noise(math.nan), lambda: Clipping(1.0), lambda: Quantisation(21), lambda: ToneCurve("log"),
        # Distributions.
        lambda: RandomSensor(noise=1.5), lambda: RandomScenes(glossy=0.6, mirror=0.6),
        lambda: RandomScenes(opacity=(0.5, 1.5)), lambda: RandomSensor(bits=(8, 9.5)),
    ],
)  # fmt: skip
def test_what_cannot_be_rendered_is_refused(make):
    with pytest.raises(InputError):
        make()
