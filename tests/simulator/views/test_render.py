"""Views of scenes against closed forms, and the quick way against the slow one."""

import pytest
import torch
from hypothesis import HealthCheck, given, settings

from lfref.functional import fourier
from lfref.simulator import bitmaps
from lfref.simulator import views as render
from lfref.simulator.materials import Emissive
from lfref.simulator.mattes import Disc, Polygon
from lfref.simulator.scene import Camera, Light, Scene, Surface
from lfref.simulator.surfaces import Dome, Plane
from lfref.simulator.textures import Checker, Flat, Gradient, Noise, Stripes
from tests.simulator import drawing

CAMERA = Camera((5, 5), (40, 48))
RIGHT_HALF = Polygon(((0.0, -300.0), (300.0, -300.0), (300.0, 300.0), (0.0, 300.0)))


def fourier_shifted(image, shift_x, shift_y):
    """f(x + shift), the image mirrored at its ends so that it meets itself."""
    height, width = image.shape[-2:]
    mirrored = torch.cat([image, image.flip(-1)], dim=-1)
    mirrored = torch.cat([mirrored, mirrored.flip(-2)], dim=-2).double()
    rows = fourier.shift_phases(fourier.frequencies(2 * height), torch.tensor(shift_y))
    columns = fourier.shift_phases(fourier.half_frequencies(2 * width), torch.tensor(shift_x))
    shifted = torch.fft.irfft2(torch.fft.rfft2(mirrored) * rows[:, None] * columns, s=mirrored.shape[-2:])
    return shifted[..., :height, :width]


@pytest.mark.parametrize("disparity", [-0.8, 0.37, 1.0])
@pytest.mark.parametrize("texture", [Noise(exponent=1.0), Noise(hardness=1.0), Checker(9.0, angle=20.0), Stripes(6.0)])
def test_views_of_a_parallel_plane_are_shifted_central_views(texture, disparity):
    camera = Camera((5, 5), (80, 90))
    views = drawing.painted_views(Scene(camera, (Surface(Plane(disparity), texture),)))
    inner = (..., slice(20, -20), slice(20, -20))
    for v, u in ((0, 4), (2, 3), (3, 1)):
        expected = fourier_shifted(views[2, 2], -disparity * (u - 2), -disparity * (v - 2))
        assert drawing.psnr(views[v, u][inner], expected[inner]) > 55


def test_views_of_a_slanted_plane_follow_its_closed_form():
    a, b, disparity, period = 0.02, -0.01, 0.3, 14.0
    views = drawing.painted_views(Scene(CAMERA, (Surface(Plane(disparity, (a, b)), Gradient(period)),)))
    y, x = torch.meshgrid(drawing.centred(40), drawing.centred(48), indexing="ij")
    for v, u in ((0, 0), (1, 4), (2, 2)):
        p, q = u - 2, v - 2
        at_x = x - p * (disparity + a * x + b * y) / (1 + a * p + b * q)
        expected = 0.5 - 0.3 * torch.cos(2 * torch.pi * at_x / period)
        assert drawing.psnr(views[v, u, 0], expected) > 60


def test_a_half_plane_hides_what_is_behind_it():
    far, near = Surface(Plane(-1.0), Flat((0.2, 0.2, 0.2))), Surface(Plane(1.5), Flat((0.8, 0.8, 0.8)), RIGHT_HALF)
    views = drawing.painted_views(Scene(CAMERA, (near, far)))
    x = drawing.centred(48).expand(40, -1)
    for u in range(5):
        expected = 0.2 + 0.6 * (x - 1.5 * (u - 2) + 0.5).clamp(0, 1)
        torch.testing.assert_close(views[1, u, 0].double(), expected, atol=0.025, rtol=0)
        assert drawing.psnr(views[1, u, 0], expected) > 45


def test_half_transparent_surfaces_mix_and_light_and_gain_multiply():
    surfaces = Surface(Plane(0.0), Flat((0.2, 0.2, 0.2))), Surface(Plane(0.5), Flat((1.0, 1.0, 1.0)), opacity=0.5)
    views = drawing.painted_views(Scene(CAMERA, surfaces, Light(0.5)))
    torch.testing.assert_close(views, torch.full_like(views, 0.3), atol=1e-6, rtol=0)
    lamp = Surface(Plane(1.0), Flat((1.0, 1.0, 1.0)), material=Emissive(4.0))
    views = drawing.painted_views(Scene(CAMERA, (*surfaces, lamp), Light(0.5)))
    torch.testing.assert_close(views, torch.full_like(views, 4.0), atol=1e-5, rtol=0)


def test_planes_that_cross_change_places_where_they_meet():
    one = Surface(Plane(0.0, (0.04, 0.0)), Flat((1.0, 0.0, 0.0)))
    other = Surface(Plane(0.0, (-0.04, 0.0)), Flat((0.0, 1.0, 0.0)))
    for surfaces in ((one, other), (other, one)):
        views = drawing.painted_views(Scene(CAMERA, surfaces))
        assert bool((views[:, :, 0, :, 24:] > 0.9999).all())
        assert bool((views[:, :, 1, :, :24] > 0.9999).all())
        assert float(views[:, :, 2].max()) == 0


def test_a_dome_breaks_through_a_plane_within_a_circle():
    dome = Surface(Dome(-0.5, 1.0, 20.0), Flat((1.0, 0.0, 0.0)))
    view = drawing.painted_views(Scene(CAMERA, (dome, Surface(Plane(0.0), Flat((0.0, 1.0, 0.0))))))[2, 2, 0]
    radius = torch.hypot(drawing.centred(48), drawing.centred(40)[:, None])
    edge = 20 * (1 - 0.5**0.5) ** 0.5
    assert bool((view[radius < edge - 1] > 0.9999).all())
    assert bool((view[radius > edge + 1] == 0).all())


@pytest.mark.parametrize("grid", [(1, 1), (2, 5), (4, 3)])
def test_the_central_view_and_single_views_are_radiance_there(grid):
    camera = Camera(grid, (20, 23))
    scene = Scene(camera, (Surface(Plane(-0.7), Noise()), Surface(Plane(0.9), Checker(8.0), Disc(6.0))))
    layers = bitmaps.paint(scene)
    views, (p, q) = render.views(layers, camera), drawing.view_points(camera)
    expected = render.radiance(layers, p, q, *camera.pixels()).unflatten(0, grid)
    torch.testing.assert_close(views, expected, atol=1e-5, rtol=0)


@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(drawing.SCENES)
def test_any_legal_scene_is_rendered_alike_by_the_quick_and_the_slow_way(scene):
    views = drawing.painted_views(scene)
    assert bool(views.isfinite().all())
    assert float(views.min()) >= 0
    slow = drawing.slow_views(scene)
    torch.testing.assert_close(views, slow, atol=1e-5, rtol=1e-5)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_gpu_renders_the_same():
    surfaces = (
        Surface(Plane(-0.7), Noise()),
        Surface(Plane(0.1, (0.01, 0.0)), Checker(8.0), Disc(12.0)),
        Surface(Dome(0.3, 0.4, 20.0), Stripes(6.0), Disc(9.0, (9.0, 0.0))),
    )
    scene = Scene(CAMERA, surfaces)
    there = render.views(bitmaps.paint(scene, "cuda"), CAMERA)
    assert there.is_cuda
    torch.testing.assert_close(there.cpu(), drawing.painted_views(scene), atol=1e-5, rtol=0)
