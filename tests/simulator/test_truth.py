"""The truth against closed forms, against 64 x 64 points of the aperture, and what its planes need."""

import math

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lfref.functional.psnr import psnr
from lfref.simulator import bitmaps, focal_planes, painting, truth, views
from lfref.simulator.focal_planes import Windows, cells_needed, visible_layers
from lfref.simulator.layers import Layer
from lfref.simulator.materials import Glass, Glossy, Mirror
from lfref.simulator.mattes import Disc, Full, Leaf, Outline, Perforated, Polygon, Twigs
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import Dome, Plane
from lfref.simulator.textures import Checker, Flat, Noise
from tests.simulator import drawing

WAVES = [(0.05, 0.02), (0.11, -0.17), (0.0, 0.3)]
"""Frequencies (fx, fy) of an analytic texture, in cycles per pixel."""
HALF_PLANE = Polygon(((-300.0, -300.0), (0.0, -300.0), (0.0, 300.0), (-300.0, 300.0)))
OCCLUDER = (0.8, 0.3, 0.1)


def noise(mean: float, hardness: float = 0.5) -> Noise:
    return Noise((mean, 0.5, 1 - mean), (0.3, 0.4, 0.3), exponent=1.2, hardness=hardness)


FAR = Surface(Plane(-0.9), noise(0.4))
SCENES = {
    "islands": (
        FAR,
        Surface(Plane(-0.2), noise(0.7), Disc(7.0, (-7.0, -4.0))),
        Surface(Plane(0.9), noise(0.2), Disc(6.0, (8.0, 5.0))),
    ),
    "twigs": (FAR, Surface(Plane(0.8), noise(0.2), Twigs(15.0, 2.0, foot=(0.0, 14.0)))),
    "leaf": (
        FAR,
        Surface(Plane(0.3), Checker(9.0), opacity=0.4),
        Surface(Plane(0.8), noise(0.6), Leaf(30.0, 9.0, 30.0)),
    ),
    "perforated": (Surface(Plane(-0.5), Checker(9.0)), Surface(Plane(0.7), noise(0.8), Perforated(16.0, 5.0, 20.0))),
    "slanted": (
        Surface(Plane(-0.3, (0.01, 0.004)), noise(0.4)),
        Surface(Plane(0.8, (-0.008, 0.0)), noise(0.3), Disc(10.0)),
    ),
    "dome": (FAR, Surface(Dome(0.0, 0.9, 26.0), noise(0.7), Disc(12.0))),
    "crossing": (Surface(Plane(0.0, (0.02, 0.0)), noise(0.3)), Surface(Plane(0.0, (-0.02, 0.0)), noise(0.7))),
    "glossy": (
        Surface(Plane(-0.5), noise(0.3), material=Glossy(0.6, 8.0, 5.0)),
        Surface(Plane(0.6), noise(0.7), Leaf(30.0, 10.0)),
    ),
    "mirror": (
        FAR,
        Surface(Plane(0.4), noise(0.7), Disc(12.0), Mirror(0.7, Checker(9.0), -1.5)),
        Surface(Plane(0.9), Flat(), Disc(8.0, (9.0, 0.0)), Glass(0.2, noise(0.5), -2.0), opacity=0.3),
    ),
}


def painted(name: str, camera: Camera) -> list[Layer]:
    return painting.paint(Scene(camera, SCENES[name]), reach=7.0)


def brute_force(layers: list[Layer], camera: Camera, slope: float, n: int = 64) -> torch.Tensor:
    """The mean of pictures from n x n points of the square about the aperture, none of them blurred."""
    centres = (torch.arange(n, dtype=torch.float64) + 0.5) / n - 0.5
    pictures = views.render(layers, camera, centres * camera.grid[1], centres * camera.grid[0], slope)
    is_open = torch.ones(n, n, dtype=torch.bool)
    if camera.aperture == "disc":
        is_open = torch.hypot(centres, centres[:, None]) <= 0.5
    return pictures[is_open].double().mean(0)


def waves(camera: Camera, disparity: float, matte: Outline = Full(), dtype: torch.dtype = torch.float32) -> Layer:  # noqa: B008
    """A layer of `WAVES`, painted without the textures' own filters."""
    height, width = (length / 2 + 60 for length in camera.size)
    canvas = bitmaps.covering((-width, -height, width, height), (2, 2))
    colour = 0.5 + sum(0.15 * (math.tau * (fx * canvas.x + fy * canvas.y[:, None])).cos() for fx, fy in WAVES)
    samples = torch.stack([*[colour] * 3, torch.ones_like(colour)]) * matte.opacity(canvas.x, canvas.y)
    return Layer(Surface(Plane(disparity), Flat(), matte), bitmaps.Bitmap(canvas, samples.to(dtype)))


def transfer(camera: Camera, e: float, fx: float, fy: float) -> float:
    """Contrast that a wave keeps at relative slope e."""
    across, down = e * camera.grid[1] * fx, e * camera.grid[0] * fy
    if camera.aperture == "square":
        return float(torch.sinc(torch.tensor([across, down])).prod())
    r = torch.tensor(math.pi * math.hypot(across, down), dtype=torch.float64)
    return float(2 * torch.special.bessel_j1(r) / r) if r > 0 else 1.0


@pytest.mark.parametrize("shape", ["square", "disc"])
@pytest.mark.parametrize(
    ("slope", "grid"), [(0.3, (7, 7)), (0.35, (5, 7)), (-1.0, (5, 7)), (-3.0, (7, 7)), (-7.0, (7, 7))]
)
def test_a_single_plane_is_blurred_by_the_aperture(shape, slope, grid):
    camera = Camera(grid=grid, size=(46, 50), aperture=shape)
    x, y = camera.pixels()
    expected = 0.5 + sum(
        0.15 * transfer(camera, slope - 0.3, fx, fy) * (math.tau * (fx * x + fy * y)).cos() for fx, fy in WAVES
    )
    picture = truth.stack([waves(camera, 0.3)], camera, [slope])[0]
    assert psnr(picture, expected.expand(3, -1, -1).float()) > 57


@pytest.mark.parametrize("slope", [-3.0, -0.4, 0.0, 0.6])
def test_a_half_plane_hides_what_each_point_of_the_aperture_cannot_see(slope):
    camera = Camera(size=(40, 48))
    near = painting.paint(Scene(camera, (Surface(Plane(0.6), Flat(OCCLUDER), HALF_PLANE),)), reach=3.0)
    picture = truth.stack([waves(camera, -0.4), *near], camera, [slope])[0]
    assert psnr(picture, half_plane(camera, slope + 0.4, slope - 0.6)) > 50


def half_plane(camera: Camera, e_far: float, e_near: float) -> torch.Tensor:
    """The mean over p of what is seen at X = x + e p: the near half plane X < 0, or the waves behind it."""
    x, y = (pixels[0, :, :] for pixels in camera.pixels())
    half = camera.grid[1] / 2
    edges = ((torch.arange(200, dtype=torch.float64) + 0.5) / 200 - 0.5)[:, None, None]  # the matte's ramp, 1 px wide
    if e_near == 0:
        low, high = torch.where(x > edges, -half, half), torch.full_like(x - edges, half)
    else:
        crossing = ((edges - x) / e_near).clamp(-half, half)
        low, high = (crossing, half) if e_near > 0 else (-half, crossing)
    share = (high - low).mean(0) / (2 * half)
    far = 0.5 * share
    for fx, fy in WAVES:
        # A wave integrated over p from low to high, as a sinc about the middle.
        middle, width = (high + low) / 2, high - low
        part = width / (2 * half) * torch.sinc(fx * e_far * width)
        phase = math.tau * (fx * (x + e_far * middle) + fy * y)
        far = far + 0.15 * float(torch.sinc(torch.tensor(fy * e_far * camera.grid[0]))) * (part * phase.cos()).mean(0)
    return torch.stack([(far + colour * (1 - share)).float().expand(camera.size) for colour in OCCLUDER])


def agreement(name: str, shape: str, slope: float, size: tuple[int, int] = (32, 34)) -> float:
    camera = Camera(size=size, aperture=shape)
    layers = painted(name, camera)
    expected = brute_force(layers, camera, slope)
    return float(psnr(truth.stack(layers, camera, [slope])[0], expected.float()))


@pytest.mark.parametrize("shape", ["square", "disc"])
@pytest.mark.parametrize("name", list(SCENES))
def test_cells_agree_with_brute_force_in_and_out_of_focus(name, shape):
    assert min(agreement(name, shape, slope) for slope in (-3.0, 0.4)) > (55 if name == "crossing" else 68)


@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(drawing.SCENES, st.floats(-3, 3))
def test_cells_agree_with_brute_force_in_any_legal_scene(scene, slope):
    layers = painting.paint(scene, reach=abs(slope))
    picture, expected = truth.stack(layers, scene.camera, [slope])[0], brute_force(layers, scene.camera, slope, 32)
    scale = max(1.0, float(expected.max()))  # lamps are brighter than white
    assert psnr(picture / scale, expected.float() / scale) > 50


@pytest.mark.parametrize("name", ["islands", "perforated", "leaf"])
def test_cells_agree_with_brute_force_at_the_strongest_blur(name):
    assert agreement(name, "disc", -7.0, size=(44, 44)) > 70


def one_layer(slope, aperture="square", grid=(7, 7), n_cells=9, matte=Full()):  # noqa: B008  frozen
    camera = Camera(grid, (40, 50), aperture)
    layers = painting.paint(Scene(camera, (Surface(Plane(-1.0), Noise(), matte),)), reach=abs(slope))
    return focal_planes.focal_planes(layers, camera, [slope], n_cells)[0]


@pytest.mark.parametrize("aperture", ["square", "disc"])
@pytest.mark.parametrize(("grid", "slope"), [((7, 7), 0.5), ((4, 7), -1.0), ((4, 7), -2.3)])
@pytest.mark.parametrize("matte", [Full(), Disc(9.0, (14.0, -3.0))])
def test_the_filter_of_a_single_layer_is_the_sum_of_all_cells(aperture, grid, slope, matte):
    plane = one_layer(slope, aperture, grid, matte=matte)
    expected = truth.render(plane)
    torch.testing.assert_close(truth.filter_layer(plane), expected, atol=1e-6, rtol=0)


WALL = Surface(Plane(-1.0), Noise())


def test_a_camera_sets_the_error_of_its_truths():
    def of_plane(error):
        camera = Camera(size=(40, 50), truth_error=error)
        layers = painting.paint(Scene(camera, (WALL, Surface(Plane(0.0), Noise(), Disc(9.0)))), reach=5.0)
        return cells_needed(layers, camera, -5.0).fine, truth.stack(layers, camera, [-5.0])

    (many, exact), (few, rough) = of_plane(1e-4), of_plane(4e-4)
    assert (many, few) == (26, 14)  # by a blur of 28 pixels
    assert (rough - exact).square().mean().sqrt() < 4e-4


def visible(surfaces, slope, other_slopes=()):
    camera = Camera(size=(40, 50))
    layers = painting.paint(Scene(camera, surfaces), reach=3.0)
    (plane, *_) = focal_planes.focal_planes(layers, camera, [slope, *other_slopes])
    assert visible_layers(layers, slope, Windows(camera, 40)) == plane.layers
    return [surfaces.index(layer.surface) for layer in plane.layers]


def test_layers_behind_an_opaque_one_or_outside_a_plane_are_left_out():
    assert visible((WALL, Surface(Plane(0.5), Noise(), Disc(900.0))), 0.5) == [1]
    island = Surface(Plane(0.5), Flat(), Disc(4.0, (42.0, 0.0)))
    assert visible((WALL, island), 0.5, [-3.0]) == [0]
    assert visible((WALL, island), -3.0, [0.5]) == [0, 1]
