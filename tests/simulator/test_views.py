"""Views against closed forms, the loops against PyTorch's operations, and what the central view shows."""

import pytest
import torch
from hypothesis import HealthCheck, given, settings

from lfref.functional import fourier
from lfref.simulator import painting, views
from lfref.simulator.materials import Glossy
from lfref.simulator.mattes import Disc, Polygon, Twigs
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Checker, Flat, Gradient, Noise
from tests.simulator import drawing, eager

CAMERA = Camera((5, 5), (40, 48))
RIGHT_HALF = Polygon(((0.0, -300.0), (300.0, -300.0), (300.0, 300.0), (0.0, 300.0)))


def fourier_shifted(image, shift_x, shift_y):
    """f(x + shift), the image mirrored at its ends so that it meets itself."""
    height, width = image.shape[-2:]
    mirrored = torch.cat([image, image.flip(-1)], dim=-1)
    mirrored = torch.cat([mirrored, mirrored.flip(-2)], dim=-2).double()
    rows = torch.complex(*fourier.shift_phases(fourier.frequencies(2 * height), torch.tensor(shift_y)))
    columns = torch.complex(*fourier.shift_phases(fourier.half_frequencies(2 * width), torch.tensor(shift_x)))
    shifted = torch.fft.irfft2(torch.fft.rfft2(mirrored) * rows[:, None] * columns, s=mirrored.shape[-2:])
    return shifted[..., :height, :width]


@pytest.mark.parametrize("disparity", [-0.8, 0.37, 1.0])
@pytest.mark.parametrize("texture", [Noise(hardness=1.0), Checker(9.0, angle=20.0)])
def test_views_of_a_parallel_plane_are_shifted_central_views(texture, disparity):
    camera = Camera((5, 5), (80, 90))
    pictures = drawing.painted_views(Scene(camera, (Surface(Plane(disparity), texture),)))
    inner = (..., slice(20, -20), slice(20, -20))
    for v, u in ((0, 4), (2, 3), (3, 1)):
        expected = fourier_shifted(pictures[2, 2], -disparity * (u - 2), -disparity * (v - 2))
        assert drawing.psnr(pictures[v, u][inner], expected[inner]) > 55


def test_views_of_a_slanted_plane_follow_its_closed_form():
    a, b, disparity, period = 0.02, -0.01, 0.3, 14.0
    pictures = drawing.painted_views(Scene(CAMERA, (Surface(Plane(disparity, (a, b)), Gradient(period)),)))
    y, x = torch.meshgrid(drawing.centred(40), drawing.centred(48), indexing="ij")
    for v, u in ((0, 0), (1, 4), (2, 2)):
        p, q = u - 2, v - 2
        at_x = x - p * (disparity + a * x + b * y) / (1 + a * p + b * q)
        expected = 0.5 - 0.3 * torch.cos(2 * torch.pi * at_x / period)
        assert drawing.psnr(pictures[v, u, 0], expected) > 60


def test_a_half_plane_hides_what_is_behind_it():
    far, near = Surface(Plane(-1.0), Flat((0.2, 0.2, 0.2))), Surface(Plane(1.5), Flat((0.8, 0.8, 0.8)), RIGHT_HALF)
    pictures = drawing.painted_views(Scene(CAMERA, (near, far)))
    x = drawing.centred(48).expand(40, -1)
    for u in range(5):
        expected = 0.2 + 0.6 * (x - 1.5 * (u - 2) + 0.5).clamp(0, 1)
        torch.testing.assert_close(pictures[1, u, 0].double(), expected, atol=0.025, rtol=0)
        assert drawing.psnr(pictures[1, u, 0], expected) > 45


def test_planes_that_cross_change_places_where_they_meet():
    one = Surface(Plane(0.0, (0.04, 0.0)), Flat((1.0, 0.0, 0.0)))
    other = Surface(Plane(0.0, (-0.04, 0.0)), Flat((0.0, 1.0, 0.0)))
    for surfaces in ((one, other), (other, one)):
        pictures = drawing.painted_views(Scene(CAMERA, surfaces))
        assert bool((pictures[:, :, 0, :, 24:] > 0.9999).all())
        assert bool((pictures[:, :, 1, :, :24] > 0.9999).all())
        assert float(pictures[:, :, 2].max()) == 0


@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(drawing.SCENES)
def test_any_legal_scene_is_rendered_alike_by_the_quick_and_the_slow_way(scene):
    pictures = drawing.painted_views(scene)
    assert bool(pictures.isfinite().all())
    assert float(pictures.min()) >= 0
    slow = drawing.slow_views(scene)
    torch.testing.assert_close(pictures, slow, atol=1e-5, rtol=1e-5)
    masks = views.masks(painting.paint(scene), scene.camera, len(scene.surfaces))
    assert masks.shape == (len(scene.surfaces), *scene.camera.size)
    assert float(masks.min()) >= 0
    assert float(masks.sum(0).max()) <= 1 + 1e-6


UNEVEN = Camera((3, 4), (37, 45))
SURFACES = (
    Surface(Plane(-1.2), Noise()),
    Surface(Plane(-0.2, (0.005, 0.0)), Checker(8.0), Disc(14.0, (-15.0, 2.0))),
    Surface(Plane(0.8), Noise(), Disc(9.0, (8.0, -12.0)), Glossy()),
    Surface(Plane(1.1), Flat(), Twigs(15.0)),
)


CROSSING = (Surface(Plane(0.0, (0.02, 0.0)), Checker(9.0)), Surface(Plane(0.0, (-0.02, 0.0)), Noise()))


@pytest.mark.parametrize("surfaces", [SURFACES, (*SURFACES, *CROSSING)])
def test_pictures_may_be_seen_from_any_points_and_registered_on_any_plane(surfaces):
    layers = painting.paint(Scene(UNEVEN, tuple(surfaces)), reach=2.0)
    p, q = torch.tensor([-1.3, 0.4], dtype=torch.float64), torch.tensor([0.9], dtype=torch.float64)
    result = views.render(layers, UNEVEN, p, q, -1.7)
    x, y = UNEVEN.pixels()
    rays = p, q.expand(2), x - 1.7 * p[:, None, None], y - 1.7 * q
    torch.testing.assert_close(result[0], eager.radiance(layers, *rays), atol=1e-5, rtol=0)


CENTRAL = Camera((3, 3), (24, 30))
LEFT_HALF = Polygon(((-300.0, -300.0), (0.0, -300.0), (0.0, 300.0), (-300.0, 300.0)))


def test_masks_share_what_half_transparent_surfaces_leave():
    surfaces = (
        Surface(Plane(1.0), Flat(), LEFT_HALF, opacity=0.25),
        Surface(Plane(-1.0), Flat()),
        Surface(Plane(0.0), Flat(), opacity=0.5),
        Surface(Plane(-2.0), Flat()),
    )
    masks = views.masks(painting.paint(Scene(CENTRAL, surfaces)), CENTRAL, 4)
    expected = torch.tensor([[0.25, 0.0], [0.375, 0.5], [0.375, 0.5], [0.0, 0.0]])
    torch.testing.assert_close(masks[:, 11, [2, 27]], expected)


def test_disparity_is_that_of_what_hides_at_least_half():
    surfaces = (
        Surface(Plane(-0.5, (0.0, 0.01)), Flat(), Disc(9.0)),
        Surface(Plane(0.5), Flat(), LEFT_HALF, opacity=0.4),
        Surface(Plane(0.7), Flat(), Disc(3.0), opacity=0.6),
    )
    result = views.disparity(painting.paint(Scene(CENTRAL, surfaces)), CENTRAL)
    y = torch.arange(24) - 11.5
    torch.testing.assert_close(result[5:18, 10], -0.5 + 0.01 * y[5:18])
    assert result[11, 15] == 0.7
    assert result[0, 0] == 0
