"""What planes need: cells that cover the aperture, filters that blur like a box, windows, and the visible layers."""

import math

import pytest

from lfref.simulator import focal_planes, painting, truth
from lfref.simulator.focal_planes import Windows, cells_needed, visible_layers
from lfref.simulator.materials import Glossy, Mirror
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Flat, Noise

FAR = Surface(Plane(-1.0), Noise())
ISLAND = Disc(9.0)


def paint(*surfaces, camera=Camera(size=(40, 50)), reach=3.0):  # noqa: B008  frozen
    return painting.paint(Scene(camera, surfaces), reach=reach)


def planes(*surfaces, slopes=(0.5,), n_cells=None, size=(40, 50)):
    camera = Camera(size=size)
    return focal_planes.focal_planes(paint(*surfaces, camera=camera), camera, slopes, n_cells)


def within_bound(blur):
    """Even number n from which 2/5 of g B / (12 n^2) is at most 1e-4 / (1 + B / 20), g = 0.03, and its half."""
    half = max(3, math.ceil(math.sqrt(0.4 * 0.03 * blur * (1 + blur / 20) / 12e-4) / 2))
    return (2 * half, half)


@pytest.mark.parametrize(
    ("surfaces", "slope", "square", "disc"),
    [
        # One layer that moves while the others are in focus; disparities are in pixels per view step, 7 views.
        ((FAR, Surface(Plane(0.5), Flat(), ISLAND)), -1.0, (1, None), within_bound(7 * 1.5)),
        # The second fastest moves 1, the fastest 4.
        ((FAR, Surface(Plane(4.0), Flat(), ISLAND)), 0.0, within_bound(7), within_bound(28)),
        # Far from focus, and near it.
        ((FAR, Surface(Plane(0.0), Flat(), ISLAND)), -7.0, (38, 19), (42, 21)),
        ((FAR, Surface(Plane(0.1), Flat(), ISLAND)), 0.0, (6, 3), (10, 5)),
        # A single layer: a filter if it is only shifted; if not, 5.5 times the fourth root of its blur.
        ((FAR,), 0.5, (48, None), (48, None)),
        ((Surface(Plane(-1.0, (1e-9, 0.0)), Noise()),), 0.0, (9, None), (9, None)),
        ((Surface(Plane(0.0, (1e-9, 0.0)), Noise()),), -7.0, (15, None), (15, None)),
        # A mirrored picture moves apart from its mirror.
        ((Surface(Plane(-1.0), Noise(), material=Mirror(0.5, Flat(), -1.0)),), 0.0, within_bound(7), within_bound(7)),
        ((Surface(Plane(0.0), Noise(), material=Mirror(0.5, Flat(), -1.0)),), 0.0, (1, None), within_bound(7)),
        # A highlight that drifts by 4 standard deviations per view step: 19 cells at least, in both pictures.
        ((FAR, Surface(Plane(0.1), Noise(), ISLAND, Glossy(0.5, 2.0, 8.0))), 0.0, (38, 19), (38, 19)),
    ],
)
def test_the_number_of_cells_follows_the_speeds_of_layers_and_highlights(surfaces, slope, square, disc):
    for shape, expected in (("square", square), ("disc", disc)):
        camera = Camera(size=(40, 50), aperture=shape)
        layers = paint(*surfaces, camera=camera, reach=7.0)
        assert cells_needed(layers, camera, slope) == expected


def test_a_camera_sets_the_error_of_its_truths():
    def of_plane(error):
        camera = Camera(size=(40, 50), truth_error=error)
        layers = paint(FAR, Surface(Plane(0.0), Noise(), ISLAND), camera=camera, reach=5.0)
        return cells_needed(layers, camera, -5.0).fine, truth.stack(layers, camera, [-5.0])

    (many, exact), (few, rough) = of_plane(1e-4), of_plane(4e-4)
    assert (many, few) == (26, 14)  # by a blur of 28 pixels
    assert (rough - exact).square().mean().sqrt() < 4e-4


def visible(surfaces, slope, other_slopes=()):
    layers = paint(*surfaces)
    camera = Camera(size=(40, 50))
    (plane, *_) = focal_planes.focal_planes(layers, camera, [slope, *other_slopes])
    assert visible_layers(layers, slope, Windows(camera, 40)) == plane.layers
    return [surfaces.index(layer.surface) for layer in plane.layers]


def test_layers_behind_an_opaque_one_or_outside_a_plane_are_left_out():
    assert visible((FAR, Surface(Plane(0.5), Noise(), Disc(900.0))), 0.5) == [1]
    island = Surface(Plane(0.5), Flat(), Disc(4.0, (42.0, 0.0)))
    assert visible((FAR, island), 0.5, [-3.0]) == [0]
    assert visible((FAR, island), -3.0, [0.5]) == [0, 1]
