"""Bands and threads change nothing, nor does where the pictures are registered."""

import pytest
import torch

from lfref.simulator import bitmaps
from lfref.simulator import views as layer_by_layer
from lfref.simulator import views as render
from lfref.simulator.materials import Glossy
from lfref.simulator.mattes import Disc, Twigs
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Checker, Flat, Noise

CAMERA = Camera((3, 4), (37, 45))
SURFACES = (
    Surface(Plane(-1.2), Noise()),
    Surface(Plane(-0.2, (0.005, 0.0)), Checker(8.0), Disc(14.0, (-15.0, 2.0))),
    Surface(Plane(0.8), Noise(), Disc(9.0, (8.0, -12.0)), Glossy()),
    Surface(Plane(1.1), Flat(), Twigs(15.0)),
)


def views(surfaces=SURFACES, camera=CAMERA):
    return render.views(bitmaps.paint(Scene(camera, tuple(surfaces))), camera)


@pytest.mark.parametrize("band", [1, 5, 100])
@pytest.mark.parametrize("n_threads", [1, 2, 9])
def test_bands_and_threads_change_nothing(band, n_threads, monkeypatch):
    expected = views()
    monkeypatch.setattr(layer_by_layer, "BAND", band)
    monkeypatch.setattr(torch, "get_num_threads", lambda: n_threads)
    torch.testing.assert_close(views(), expected, atol=1e-6, rtol=0)


def test_a_surface_beyond_the_picture_adds_nothing():
    for geometry in (Plane(1.0), Plane(1.0, (0.001, 0.0))):
        hidden = Surface(geometry, Flat((1.0, 1.0, 1.0)), Disc(5.0, (90.0, -70.0)))
        assert float(views([hidden]).max()) == 0


def test_an_opaque_slanted_background_is_laid_over_black():
    """What memory happens to hold must not shine through, not even as NaN."""
    flat = Surface(Plane(0.0, (0.01, 0.0)), Flat((0.25, 0.5, 0.75)))
    expected = torch.tensor([0.25, 0.5, 0.75])[:, None, None].expand(3, 4, 3, 37, 45)
    torch.testing.assert_close(views([flat]), expected, atol=1e-6, rtol=0)


CROSSING = (Surface(Plane(0.0, (0.02, 0.0)), Checker(9.0)), Surface(Plane(0.0, (-0.02, 0.0)), Noise()))


@pytest.mark.parametrize("surfaces", [SURFACES, (*SURFACES, *CROSSING)])
def test_pictures_may_be_seen_from_any_points_and_registered_on_any_plane(surfaces):
    layers = bitmaps.paint(Scene(CAMERA, tuple(surfaces)), reach=2.0)
    p, q = torch.tensor([-1.3, 0.4], dtype=torch.float64), torch.tensor([0.9], dtype=torch.float64)
    found = layer_by_layer.pictures(layers, CAMERA, p, q, -1.7)
    x, y = CAMERA.pixels()
    rays = p, q.expand(2), x - 1.7 * p[:, None, None], y - 1.7 * q
    torch.testing.assert_close(found[0], render.radiance(layers, *rays), atol=1e-5, rtol=0)
