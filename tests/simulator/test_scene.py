"""Descriptions of scenes are plain, hashable, and refused where they cannot be rendered."""

from dataclasses import replace

import pytest
import torch

from lfref.errors import InputError
from lfref.simulator.mattes import Polygon
from lfref.simulator.scene import Camera, Light, Scene, Sensor, Surface
from lfref.simulator.surfaces import Dome, Plane
from lfref.simulator.textures import Flat, Noise

CAMERA = Camera((3, 5), (20, 31))
SURFACE = Surface(Plane(0.5), Noise())


def test_equal_scenes_are_one_key_and_others_are_not():
    one, same = (Scene(CAMERA, (Surface(Plane(0.5), Noise()),)) for _ in range(2))
    assert hash(one) == hash(same)
    assert {one: 1}[same] == 1
    assert replace(one, seed=1) != one
    assert replace(one, light=Light(2.0)) != one


def test_lists_are_taken_as_yaml_gives_them():
    matte = Polygon([[0, 0], [4, 0], [0, 4]])
    scene = Scene(Camera([3, 5], [20, 31]), [Surface(Plane(0.5, [0.0, 0.01]), Flat([1, 0, 0]), matte)])
    assert hash(scene) == hash(Scene(CAMERA, (Surface(Plane(0.5, (0.0, 0.01)), Flat((1, 0, 0)), matte),)))


def test_pixels_are_counted_from_the_centre():
    x, y = CAMERA.pixels()
    assert (x.shape, y.shape) == ((1, 1, 31), (1, 20, 1))
    torch.testing.assert_close(x[0, 0], torch.arange(-15, 16, dtype=torch.float64))
    assert (float(y[0, 0, 0]), float(y[0, -1, 0])) == (-9.5, 9.5)
    assert CAMERA.half_aperture == (2.5, 1.5)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Camera((0, 3)), lambda: Camera((3.5, 3)), lambda: Camera(size=(20,)), lambda: Camera(aperture="star"),
        lambda: Surface(Noise(), Noise()), lambda: Surface(Plane(0.0), "noise"),
        lambda: Surface(Plane(0.0), Flat(), opacity=1.5), lambda: Surface(Plane(0.0), Flat(), motion=(1.0,)),
        lambda: Light(-1.0), lambda: Light(colour=(1.0, 1.0)), lambda: Scene(CAMERA, ()),
        lambda: Scene(CAMERA, (Plane(0.0),)), lambda: Scene(None, (SURFACE,)),
        lambda: Scene(CAMERA, (SURFACE,), seed=-1),
    ],
)  # fmt: skip
def test_what_cannot_be_rendered_is_refused(make):
    with pytest.raises(InputError):
        make()


def test_surfaces_too_steep_for_the_aperture_are_refused():
    # Half the aperture is 2.5 and 1.5 view steps: 2.5 a + 1.5 b may be 0.5; a dome is steepest, 8 / (3 sqrt 3) of
    # bulge / radius, at 1 / sqrt 3 of its radius.
    for just in (0.99, 1.01):
        for geometry in (Plane(0.0, (0.14 * just, 0.1 * just)), Dome(0.0, 60 * just / 8 * 3**1.5 / 8, 60.0)):
            if just > 1:
                with pytest.raises(InputError, match="use a flatter surface or fewer views"):
                    Scene(CAMERA, (Surface(geometry, Flat()),))
            else:
                assert Scene(CAMERA, (Surface(geometry, Flat()),)).sensor == Sensor()
