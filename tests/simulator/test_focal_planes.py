"""What planes need: cells that cover the aperture, filters that blur like a box, windows, and the visible layers."""

import math

import numpy as np
import pytest
import torch

from lfref.simulator import bitmaps, focal_planes, painting, truth
from lfref.simulator.focal_planes import Windows, cells_needed, cut_aperture, visible_layers
from lfref.simulator.layers import disparity_span
from lfref.simulator.materials import Glossy, Mirror
from lfref.simulator.mattes import Disc, Full
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Flat, Noise
from tests.simulator import eager

FAR, NEAR = Surface(Plane(-1.0), Noise()), Surface(Plane(0.5), Noise())
ISLAND = Disc(9.0)


def paint(*surfaces, camera=Camera(size=(40, 50)), reach=3.0):  # noqa: B008  frozen
    return painting.paint(Scene(camera, surfaces), reach=reach)


def planes(*surfaces, slopes=(0.5,), n_cells=None, size=(40, 50)):
    camera = Camera(size=size)
    return focal_planes.focal_planes(paint(*surfaces, camera=camera), camera, slopes, n_cells)


@pytest.mark.parametrize("shape", ["square", "disc"])
@pytest.mark.parametrize("n_cells", [1, 4, 7])
def test_shares_add_up_to_one_and_balance_about_the_centre(shape, n_cells):
    cells = cut_aperture(Camera((5, 7), aperture=shape), n_cells)
    assert float(cells.weights.sum()) == pytest.approx(1)
    torch.testing.assert_close(cells.weights, cells.weights.flip(0, 1))
    assert float(cells.p.mean()) == pytest.approx(0, abs=1e-12)
    assert cells.weights.shape == (len(cells.q), len(cells.p))


def test_cells_of_a_square_are_equal_and_fill_it():
    cells = cut_aperture(Camera((3, 6)), 4)
    assert (len(cells.q), len(cells.p)) == (2, 4)
    assert (cells.height, cells.width) == (1.5, 1.5)
    torch.testing.assert_close(cells.p, torch.tensor([-2.25, -0.75, 0.75, 2.25], dtype=torch.float64))
    torch.testing.assert_close(cells.weights, torch.full((2, 4), 1 / 8, dtype=torch.float64))


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


def test_a_picture_whose_pixels_are_averaged_needs_the_cells_of_the_averages():
    far, near = (Surface(Plane(disparity), Noise(), matte) for disparity, matte in ((-2.0, Full()), (1.0, ISLAND)))
    fine, camera = paint(far, near, reach=8.0), Camera(size=(40, 50))
    assert cells_needed(fine, camera, -8.0, 2) == within_bound(7 * 6 / 2)


def test_a_camera_sets_the_error_of_its_truths():
    def of_plane(error):
        camera = Camera(size=(40, 50), truth_error=error)
        layers = paint(FAR, Surface(Plane(0.0), Noise(), ISLAND), camera=camera, reach=5.0)
        return cells_needed(layers, camera, -5.0).fine, truth.stack(layers, camera, [-5.0])

    (many, exact), (few, rough) = of_plane(1e-4), of_plane(4e-4)
    assert (many, few) == (26, 14)  # by a blur of 28 pixels
    assert (rough - exact).square().mean().sqrt() < 4e-4


def test_planes_are_photographed_with_two_numbers_of_cells():
    plain, moved = planes(FAR, Surface(Plane(0.5), Noise(), ISLAND), slopes=(-1.0, 0.0))
    assert plain.coarser is None
    assert (len(moved.cells.p), len(moved.coarser.cells.p)) == within_bound(3.5)
    assert moved.coarser.layers == moved.layers
    assert planes(FAR, Surface(Plane(0.5), Noise(), ISLAND), slopes=(0.0,), n_cells=4)[0].coarser is None


@pytest.mark.parametrize("width", [0.0, 0.4, 1.0, 2.5, 40.3])
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_taps_blur_as_much_as_a_box(width, share):
    taps = focal_planes.box_taps(width, np.array([3 + share]))
    n = np.arange(len(taps)) - len(taps) // 2
    assert taps.sum() == pytest.approx(1)
    assert (taps * n**2).sum() + share * (1 - share) == pytest.approx(width**2 / 12)
    np.testing.assert_allclose(taps, taps[::-1])


def test_a_surface_in_focus_is_not_filtered_and_others_are_read_at_the_relative_slope():
    cells = cut_aperture(Camera((4, 6)), 3)
    sharp, moved = focal_planes.cell_filter(0.0, cells, margin=4), focal_planes.cell_filter(-1.5, cells, margin=20)
    for taps in (sharp.down, sharp.across):
        np.testing.assert_array_equal(taps, [0, 1, 0])
    np.testing.assert_array_equal(sharp.rows, [16, 16])
    np.testing.assert_allclose(moved.columns, 80 - 6 * cells.p.numpy())
    np.testing.assert_allclose(moved.rows, 80 - 6 * cells.q.numpy())


def test_a_filter_and_a_sum_of_look_ups_are_one_filter():
    random = np.random.default_rng(0)
    samples, positions, weights = random.random(40), np.array([12.25, 15.0, 19.9, 12.25]), random.random(4)
    taps = focal_planes.box_taps(3.3, positions)
    smooth = np.convolve(samples, taps, mode="same")
    whole = np.floor(positions).astype(int)
    share = positions - whole
    expected = (weights * ((1 - share) * smooth[whole] + share * smooth[whole + 1])).sum()
    first, combined = focal_planes.combined_taps(taps, positions, weights)
    assert (combined * samples[first : first + len(combined)]).sum() == pytest.approx(expected)


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


def test_an_opaque_surface_hides_no_other_that_it_crosses():
    assert visible((NEAR, Surface(Plane(0.5, (0.02, 0.0)), Noise(), Full())), 0.5) == [0, 1]


@pytest.mark.parametrize("size", [(31, 44), (40, 50)])
@pytest.mark.parametrize("slope", [0.0, -2.0])
def test_a_window_holds_the_central_view_at_its_middle(size, slope):
    plane = planes(FAR, size=size, slopes=(slope, 0.0, -2.0))[0]
    (layer,), centre = plane.layers, torch.zeros(1, dtype=torch.float64)
    expected = eager.rgba_at(layer, centre, centre, *plane.camera.pixels())[0]
    window, margin = plane.window(layer.bitmap), plane.margin
    assert window.shape[1:] == tuple(4 * (length + 2 * margin) for length in size)
    pixels = window[:, 4 * margin :, 4 * margin :][:, : 4 * size[0] : 4, : 4 * size[1] : 4]
    torch.testing.assert_close(pixels, expected)
    top, left = plane.window_corner()
    assert (top + 4 * margin, left + 4 * margin) == (2 - 2 * size[0], 2 - 2 * size[1])


def test_surfaces_at_a_slant_are_blurred_by_how_far_each_point_is_out_of_focus():
    slanted = Surface(Plane(0.5, (0.01, 0.0)), Noise())
    (plane,) = planes(slanted, Surface(Plane(1.9), Noise(), ISLAND, Glossy()), n_cells=5)
    levels, steps, *_ = plane.copy_blur(plane.layers[0])
    # Copies and linear look-ups together blur as much as the filter of a surface of the same relative slope.
    e = 100 / steps
    cell = focal_planes.cell_filter(e, plane.cells, margin=0)
    n = np.arange(len(cell.across)) - len(cell.across) // 2
    assert levels[0] == 1
    assert np.interp(levels[100], range(9), [bitmaps.variance(level) for level in range(9)]) == pytest.approx(
        (cell.across * n**2).sum()
    )


@pytest.mark.parametrize("slope", [0.5, -2.0])
def test_a_slanted_layer_reads_the_copies_that_its_range_of_blur_asks_for_and_what_rays_see(slope):
    (plane,) = planes(Surface(Plane(0.5, (0.01, 0.0)), Noise()), n_cells=5, slopes=(slope,))
    (layer,) = plane.layers
    blur, canvas = plane.copy_blur(layer), layer.bitmap.canvas
    ends = [abs(slope - end) for end in disparity_span(plane.camera, layer.surface.geometry, abs(slope))]
    assert blur.nearest == (0 if slope == 0.5 else min(ends))
    wanted = np.interp(np.linspace(blur.nearest, max(ends), 50), np.arange(256) / blur.steps, blur.levels)
    assert (blur.copies()[0], blur.copies()[-1]) == (int(wanted.min()), math.ceil(wanted.max()))
    top, left, bottom, right = plane.read_box(layer, blur.copies())
    margin = max(bitmaps.margin(level) for level in blur.copies())
    assert top >= 2 * canvas.top - margin
    assert left >= 2 * canvas.left - margin
    reach = [(length - 1) / 2 + max(ends) * 3.5 for length in (50, 40)]  # x + (s - D) p at the corners
    assert right >= min(4 * reach[0], 2 * (canvas.left + canvas.width))
    assert bottom >= min(4 * reach[1], 2 * (canvas.top + canvas.height))


def test_if_some_layers_are_sorted_all_rays_are_followed():
    apart = [Surface(Plane(1.5), Noise(), Disc(5.0)), Surface(Plane(-0.9), Noise(), Disc(7.0))]
    crossing = [Surface(Plane(0.0, (a, 0.0)), Noise(), Disc(9.0)) for a in (0.02, -0.02)]
    for surfaces, n_traced in (((FAR, *apart), 0), ((FAR, *apart, crossing[0]), 1), ((FAR, *apart, *crossing), 5)):
        (plane,) = planes(*surfaces, n_cells=3)
        assert len(plane.traced) == n_traced
        assert plane.is_sorted is (n_traced == 5)
        assert plane.crosses().sum() == (2 if n_traced == 5 else 0)
