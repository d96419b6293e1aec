"""Painted surfaces: the right point, the right light, the same in any reach; and which changes run."""

import pytest
import torch

from lfref.simulator import painting
from lfref.simulator.materials import Emissive, Glass, Glossy, Matte, Mirror
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Camera, Light, Scene, Surface
from lfref.simulator.surfaces import Dome, Plane
from lfref.simulator.textures import Flat, Gradient
from tests.simulator import drawing, eager

CAMERA = Camera((5, 5), (40, 48))
GREY = Flat((0.5, 0.5, 0.5))


def painted(surface, light=Light(), reach=0.0, seed=0, camera=CAMERA):  # noqa: B008  frozen
    return painting.paint(Scene(camera, (surface,), light, seed=seed), reach=reach)[0]


def rgba_of(surface, p=0.0, q=0.0, **options):
    x, y = CAMERA.pixels()
    return eager.rgba_at(painted(surface, **options), torch.tensor([p]), torch.tensor([q]), x, y)[0]


def wave(x, period):
    return 0.5 - 0.3 * torch.cos(2 * torch.pi * x / period)


@pytest.mark.parametrize("geometry", [Plane(0.7), Plane(-0.5, (0.02, 0.03)), Dome(0.2, 0.8, 25.0, (3.0, 2.0))])
@pytest.mark.parametrize(("p", "q"), [(0.0, 0.0), (2.0, -2.0), (-2.5, 1.3)])
def test_a_pixel_shows_the_point_where_its_ray_meets_the_surface(geometry, p, q):
    x, y = CAMERA.pixels()
    at_x, at_y = drawing.intersect(geometry, x, y, torch.tensor(p), torch.tensor(q))
    expected = wave((at_x + at_y) * 0.5**0.5, 12.0).expand(1, 40, 48)[0]
    rgba = rgba_of(Surface(geometry, Gradient(12.0, angle=45.0)), p, q)
    torch.testing.assert_close(rgba[0].double(), expected, atol=2e-3, rtol=0)
    torch.testing.assert_close(rgba[3], torch.ones(40, 48))


def test_light_falls_on_all_but_what_shines_itself():
    light = Light(2.0, (1.0, 0.5, 0.0))
    for material, expected in ((Matte(), (1.0, 0.5, 0.0)), (Emissive(3.0), (1.5, 1.5, 1.5))):
        rgba = rgba_of(Surface(Plane(0.0), GREY, material=material), light=light)
        torch.testing.assert_close(rgba[:3, 5, 5], torch.tensor(expected))


def test_a_highlight_moves_with_the_aperture_point():
    glossy = Surface(Plane(0.5), Flat((0.0, 0.0, 0.0)), material=Glossy(0.8, 3.0, 4.0, (1.5, 0.5)))
    for p, q in ((0.0, 0.0), (2.0, -1.0)):
        # On the surface it is at centre + drift p, in the picture 0.5 p further.
        rgba = rgba_of(glossy, p, q)
        x, y = CAMERA.pixels()
        off = (x - 1.5 - 4.5 * p) ** 2 + (y - 0.5 - 4.5 * q) ** 2
        torch.testing.assert_close(rgba[:3], (0.8 * torch.exp(-off / 18)).float().expand(3, -1, -1), atol=1e-6, rtol=0)


@pytest.mark.parametrize("kind", [Mirror, Glass])
def test_a_mirror_adds_a_picture_of_another_disparity_to_its_own(kind):
    material = kind(0.4, Gradient(12.0), -1.0)
    rgba = rgba_of(Surface(Plane(0.5), GREY, material=material, opacity=0.25), 2.0)
    x, _ = CAMERA.pixels()
    expected = 0.6 * 0.25 * 0.5 + 0.4 * wave(x[0] + 2.0, 12.0)
    torch.testing.assert_close(rgba[:3], expected.float().expand(3, 40, 48), atol=1e-3, rtol=0)
    torch.testing.assert_close(rgba[3], torch.full((40, 48), 1 - 0.6 * 0.75))


def test_motion_smears_along_its_way():
    still, moved = (
        rgba_of(Surface(Plane(0.0), GREY, Disc(6.0), motion=motion))[3].double() for motion in ((0.0, 0.0), (8.0, 0.0))
    )
    x, y = CAMERA.pixels()
    assert float(moved.sum()) == pytest.approx(float(still.sum()), rel=5e-3)
    for axis, more in ((x, 64 / 12), (y, 0.0)):
        spread = [float((opacity * axis[0] ** 2).sum() / opacity.sum()) for opacity in (still, moved)]
        assert spread[1] - spread[0] == pytest.approx(more, abs=0.06)


SEVERAL = (
    Surface(Plane(1.0), GREY, Disc(9.0)),
    Surface(Plane(-1.0), GREY, opacity=0.5),
    Surface(Dome(-0.5, 1.0, 20.0), GREY, Disc(5.0), Glossy()),
    Surface(Plane(0.4), GREY, Disc(6.0), Mirror(1.0), opacity=0.0),
)


def test_layers_go_from_far_to_near_and_carry_only_what_they_need():
    layers = painting.paint(Scene(CAMERA, SEVERAL))
    assert [layer.index for layer in layers] == [1, 2, 3, 0]
    assert [layer.is_traced for layer in layers] == [False, True, True, False]
    assert [layer.highlight is not None for layer in layers] == [False, True, False, False]
    assert [layer.reflection is not None for layer in layers] == [False, False, True, False]
    assert [layer.is_sorted for layer in layers] == [False, True, True, False]
    assert layers[1].surface.geometry.disparity_range((9, 9)) == (-0.5, 0.5)


def test_what_a_nearer_surface_hides_all_over_is_not_painted():
    scene = Scene(CAMERA, (*SEVERAL, Surface(Plane(0.6), GREY), Surface(Dome(0.6, 0.2, 20.0), GREY)))
    layers = painting.paint(scene)
    assert [layer.index for layer in layers] == [5, 0]
    assert [painting.layers.is_backdrop(layer.surface) for layer in layers] == [True, False]
    half = Scene(CAMERA, (*SEVERAL, Surface(Plane(0.6), GREY, opacity=0.5)))
    assert len(painting.paint(half)) == 5
