"""What the central view shows, against scenes whose answer is known."""

import torch
from hypothesis import HealthCheck, given, settings

from lfref.simulator import bitmaps, views
from lfref.simulator.materials import Glossy
from lfref.simulator.mattes import Disc, Polygon
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Flat, Noise
from tests.simulator import drawing

CAMERA = Camera((3, 3), (24, 30))
LEFT_HALF = Polygon(((-300.0, -300.0), (0.0, -300.0), (0.0, 300.0), (-300.0, 300.0)))


def test_masks_share_what_half_transparent_surfaces_leave():
    surfaces = (
        Surface(Plane(1.0), Flat(), LEFT_HALF, opacity=0.25),
        Surface(Plane(-1.0), Flat()),
        Surface(Plane(0.0), Flat(), opacity=0.5),
        Surface(Plane(-2.0), Flat()),
    )
    masks = views.masks(bitmaps.paint(Scene(CAMERA, surfaces)), CAMERA, 4)
    expected = torch.tensor([[0.25, 0.0], [0.375, 0.5], [0.375, 0.5], [0.0, 0.0]])
    torch.testing.assert_close(masks[:, 11, [2, 27]], expected)


def test_masks_change_places_where_surfaces_cross():
    surfaces = (Surface(Plane(0.0, (0.04, 0.0)), Flat()), Surface(Plane(0.0, (-0.04, 0.0)), Flat()))
    right, left = views.masks(bitmaps.paint(Scene(CAMERA, surfaces)), CAMERA, 2)
    assert torch.equal(right, (torch.arange(30) >= 15).float().expand(24, 30))
    assert torch.equal(left, 1 - right)


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow])
@given(drawing.SCENES)
def test_masks_are_shares_of_what_is_seen(scene):
    masks = views.masks(bitmaps.paint(scene), scene.camera, len(scene.surfaces))
    assert masks.shape == (len(scene.surfaces), *scene.camera.size)
    assert float(masks.min()) >= 0
    assert float(masks.sum(0).max()) <= 1 + 1e-6


def test_disparity_is_that_of_what_hides_at_least_half():
    surfaces = (
        Surface(Plane(-0.5, (0.0, 0.01)), Flat(), Disc(9.0)),
        Surface(Plane(0.5), Flat(), LEFT_HALF, opacity=0.4),
        Surface(Plane(0.7), Flat(), Disc(3.0), opacity=0.6),
    )
    found = views.disparity(bitmaps.paint(Scene(CAMERA, surfaces)), CAMERA)
    y = torch.arange(24) - 11.5
    torch.testing.assert_close(found[5:18, 10], -0.5 + 0.01 * y[5:18])
    assert found[11, 15] == 0.7
    assert found[0, 0] == 0


def test_all_in_focus_is_the_view_through_the_centre():
    surfaces = (Surface(Plane(-0.5), Noise(), material=Glossy()), Surface(Plane(0.6, (0.01, 0.0)), Noise(), Disc(7.0)))
    layers = bitmaps.paint(Scene(CAMERA, surfaces))
    assert torch.equal(views.all_in_focus(layers, CAMERA), views.views(layers, CAMERA)[1, 1])
    even = Camera((4, 4), CAMERA.size)
    layers = bitmaps.paint(Scene(even, surfaces))
    view, between = views.views(layers, even)[1, 1], views.all_in_focus(layers, even)
    assert float((view - between).abs().max()) > 0.05
