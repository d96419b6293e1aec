"""What planes look at: windows of bitmaps, layers that show, and which blurred copies are read."""

import numpy as np
import pytest
import torch

from lfref.simulator import bitmaps, blurs, scenery
from lfref.simulator.materials import Glossy
from lfref.simulator.mattes import Disc, Full
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.scenery import FocalPlane, Scenery, cut
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Flat, Noise

FAR, NEAR = Surface(Plane(-1.0), Noise()), Surface(Plane(0.5), Noise())


def seen(*surfaces, size=(40, 50), slopes=(0.5,)):
    camera = Camera(size=size)
    layers = bitmaps.paint(Scene(camera, surfaces), reach=max(map(abs, slopes)))
    return Scenery(tuple(layers), camera, scenery.aperture(camera)).for_planes(slopes)


def test_what_is_behind_an_opaque_surface_is_left_out():
    assert len(seen(FAR, NEAR).layers) == 1
    nearly = Surface(Plane(0.5), Noise(), Disc(900.0))
    assert scenery.visible(seen(FAR, nearly), 0.5) == [1]


def test_what_lies_outside_a_plane_is_left_out():
    island = Surface(Plane(0.5), Flat(), Disc(4.0, (42.0, 0.0)))
    layers = seen(FAR, island, slopes=(0.5, -3.0))
    assert scenery.visible(layers, 0.5) == [0]
    assert scenery.visible(layers, -3.0) == [0, 1]


def test_an_opaque_surface_hides_nothing_that_it_crosses():
    slanted = Surface(Plane(0.5, (0.02, 0.0)), Noise(), Full())
    assert scenery.visible(seen(FAR, NEAR, slanted), 0.5) == [0, 1]


@pytest.mark.parametrize("size", [(31, 44), (40, 50)])
@pytest.mark.parametrize("slope", [0.0, -2.0])
def test_a_window_holds_the_central_view_at_its_middle(size, slope):
    layers = seen(FAR, size=size, slopes=(0.0, -2.0))
    centre = torch.zeros(1, dtype=torch.float64)
    expected = layers.layers[0].seen(centre, centre, *layers.camera.pixels())[0]
    window, margin = layers.window(layers.layers[0].bitmap, slope), layers.margin_at(slope)
    assert window.shape[1:] == tuple(2 * (length + 2 * margin) for length in size)
    pixels = window[:, 2 * margin :, 2 * margin :][:, : 2 * size[0] : 2, : 2 * size[1] : 2]
    torch.testing.assert_close(pixels, expected)
    top, left = layers.corner(slope)
    assert (top + 2 * margin, left + 2 * margin) == (1 - size[0], 1 - size[1])


def test_surfaces_at_a_slant_are_blurred_by_how_far_each_point_is_out_of_focus():
    slanted, glossy = Surface(Plane(0.5, (0.01, 0.0)), Noise()), Surface(Plane(0.2), Noise(), material=Glossy())
    whole = seen(slanted, glossy)
    plane = FocalPlane(0.5, whole, cut(whole.whole, 5))
    places, steps = plane.blurs(plane.seen.layers[1])
    e = 100 / steps
    one = scenery.cell_filter(e, plane.cells, margin=0)
    n = np.arange(len(one.across)) - len(one.across) // 2
    assert places[0] == 1
    assert np.interp(places[100], range(9), blurs.variances()[:9]) == pytest.approx((one.across * n**2).sum())
    assert not plane.blurs(plane.seen.layers[0])[0].any()


def test_if_some_layers_are_sorted_all_rays_are_followed():
    apart = [Surface(Plane(1.5), Noise(), Disc(5.0)), Surface(Plane(-0.9), Noise(), Disc(7.0))]
    crossing = [Surface(Plane(0.0, (a, 0.0)), Noise(), Disc(9.0)) for a in (0.02, -0.02)]
    for surfaces, n_followed in (((FAR, *apart), 0), ((FAR, *apart, crossing[0]), 1), ((FAR, *apart, *crossing), 5)):
        whole = seen(*surfaces)
        plane = FocalPlane(0.5, whole, cut(whole.whole, 3))
        assert len(plane.followed) == n_followed
        assert plane.is_sorted is (n_followed == 5)
        assert plane.crosses().sum() == (2 if n_followed == 5 else 0)
