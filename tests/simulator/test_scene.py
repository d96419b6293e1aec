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
    ("make", "message"),
    [
        (lambda: Camera((0, 3)), "a camera's grid must be finite numbers, at least 1"),
        (lambda: Camera((3.5, 3)), "a camera's grid must be whole numbers"),
        (lambda: Camera(size=(20,)), "a camera's size must have 2 numbers"),
        (lambda: Camera(aperture="star"), "aperture must be one of square, disc; got 'star'"),
        (lambda: Surface(Noise(), Noise()), "a surface's geometry must be one of Dome, Plane"),
        (lambda: Surface(Plane(0.0), "noise"), "a surface's texture must be one of"),
        (lambda: Surface(Plane(0.0), Flat(), opacity=1.5), "a surface's opacity must be"),
        (lambda: Surface(Plane(0.0), Flat(), motion=(1.0,)), "a surface's motion must have 2 numbers"),
        (lambda: Light(-1.0), "a light's gain must be"),
        (lambda: Light(colour=(1.0, 1.0)), "a light's colour must have 3 numbers"),
        (lambda: Scene(CAMERA, ()), "a scene needs at least one surface"),
        (lambda: Scene(CAMERA, (Plane(0.0),)), "a scene's surfaces must be one of Surface"),
        (lambda: Scene(None, (SURFACE,)), "a scene's camera must be one of Camera"),
        (lambda: Scene(CAMERA, (SURFACE,), seed=-1), "a scene's seed must be"),
    ],
)
def test_what_cannot_be_rendered_is_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


@pytest.mark.parametrize("geometry", [Plane(0.0, (0.15, 0.1)), Dome(0.0, 10.0, 60.0)])
def test_surfaces_too_steep_for_the_aperture_are_refused(geometry):
    with pytest.raises(InputError, match="use a flatter surface or fewer views"):
        Scene(CAMERA, (Surface(geometry, Flat()),))
    assert Scene(Camera((2, 1)), (Surface(replace(geometry, disparity=1.0), Flat()),)).sensor == Sensor()
