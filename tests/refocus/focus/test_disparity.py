"""The map of disparities: planes and layers come back, borders too, and a hidden half of the aperture does no harm."""

import math

import pytest
import torch

import lfref
from lfref.errors import InputError
from lfref.functional import neighbours
from lfref.refocus import lines
from lfref.refocus.disparity.disparity_map import disparity_map
from lfref.refocus.focus.extended_focus import extended_focus
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate
from tests.refocus.conftest import dirichlet, shifted_views, texture
from tests.refocus.focus.test_all_in_focus import layered_views, slanted_views

BORDER = 10


def is_border(size, width=BORDER):
    within = torch.zeros(size, dtype=torch.bool)
    within[width:-width, width:-width] = True
    return ~within


def border_off(image, width=BORDER):
    return image[..., width:-width, width:-width]


def local_plane(disparity, grid=(5, 5), size=(48, 52)):
    """Views of a plane that goes on beyond their borders, its detail as soft as optics leave it."""
    sharp = texture(3, size[0] + 2 * BORDER, size[1] + 2 * BORDER)
    return border_off(shifted_views(neighbours.smoothed(sharp, 1.0), disparity, grid))


@pytest.mark.parametrize("disparity", [-0.83, -0.25, 0.0, 0.04, 0.61])
@pytest.mark.parametrize("grid", [(7, 7), (6, 5)])
def test_a_plane_comes_back_at_every_pixel(disparity, grid):
    error = (disparity_map(local_plane(disparity, grid), -1.2, 1.2).disparity - disparity).abs()
    # Interpolation blurs, which pulls towards slopes at which shifts are whole.
    assert float(error.median()) < 0.02
    assert float(error.quantile(0.95)) < 0.08
    assert float((error[is_border(error.shape)] > 0.1).float().mean()) < 0.1


@pytest.mark.parametrize("grid", [(1, 5), (5, 1)])
def test_views_in_one_row_or_column_are_enough(grid):
    error = (disparity_map(local_plane(0.45, grid), -1.0, 1.0).disparity - 0.45).abs()
    assert float(error.median()) < 0.03


@pytest.mark.parametrize(("near", "far"), [(0.5, -0.5), (0.87, -0.38)])
def test_two_layers_come_back_up_to_the_edge_between_them(near, far):
    views, distance = layered_views(near, far)
    found = border_off(disparity_map(views, -1.0, 1.0).disparity, 6)
    truth = border_off(torch.where(distance < 20, near, far), 6)
    edge = border_off((distance - 20).abs() < 3, 6)
    is_off = (found - truth).abs() > 0.1
    assert float(is_off[~edge].float().mean()) < 0.06
    assert float(is_off.float().mean()) < 0.1


def test_what_nearer_surfaces_hide_from_half_of_the_views_comes_back():
    views, distance = layered_views(0.9, -0.6)
    beside = border_off((distance > 22) & (distance < 25), 6)
    error = (border_off(disparity_map(views, -1.0, 1.0).disparity, 6) + 0.6).abs()
    assert float((error[beside] > 0.1).float().mean()) < 0.03


def test_a_slanted_plane_comes_back_between_the_slopes_that_are_tried():
    views, disparity = slanted_views(-0.6, 1.2 / 72)
    error = (disparity_map(views, -1.0, 1.0).disparity - disparity).abs()
    assert float(border_off(error, 6).median()) < 0.02
    assert float(border_off(error, 6).max()) < 0.15


@pytest.mark.parametrize("name", ["plane", "leaves"])
def test_simulated_scenes_come_back_borders_included(name):
    made = simulate(sim30.SCENES[name], outputs=["views", "disparity"])
    found = disparity_map(made.views)
    error = (found.disparity - made.disparity).abs()
    assert float(error.median()) < 0.02
    assert float((error > 0.1).float().mean()) < 0.1
    assert float((error[is_border(error.shape, 24)] > 0.5).float().mean()) < 0.1


def test_the_range_is_found_where_none_is_given():
    views = local_plane(-0.83, (7, 7))
    error = (disparity_map(views).disparity + 0.83).abs()
    assert float(error.median()) < 0.03


@pytest.mark.parametrize(("first", "last"), [(-0.5, None), (None, 1.0)])
def test_one_end_of_the_range_may_be_given(first, last):
    found = disparity_map(local_plane(0.3), first, last).disparity
    assert float((found - 0.3).abs().median()) < 0.02


def test_nothing_outside_the_range_is_found():
    found = disparity_map(local_plane(0.6), -0.33, 0.2).disparity
    assert float(found.min()) >= -0.33 - 1e-6
    assert float(found.max()) <= 0.2 + 1e-6


def test_a_range_of_one_disparity_is_that_disparity():
    found, confidence = disparity_map(local_plane(0.6), 0.25, 0.25)
    assert bool((found == 0.25).all())
    assert not confidence.any()


def test_confidence_is_high_on_texture_and_0_where_there_is_none():
    textured = disparity_map(local_plane(0.2), -1.0, 1.0).confidence
    flat = disparity_map(torch.full((5, 5, 3, 20, 20), 0.5), -1.0, 1.0)
    assert float(textured.median()) > 0.5
    assert float(flat.confidence.abs().max()) < 0.01
    assert bool(flat.disparity.isfinite().all())
    assert float(textured.max()) < 1


def test_mirrored_views_have_a_mirrored_map():
    views, _ = layered_views(0.5, -0.5, (40, 44))
    found = disparity_map(views, -1.0, 1.0).disparity
    for axis in (-2, -1):
        mirrored = disparity_map(views.flip(axis, axis - 3), -1.0, 1.0).disparity
        torch.testing.assert_close(mirrored.flip(axis), found, atol=1e-6, rtol=0)


def test_brightness_does_not_matter():
    views = local_plane(0.3)
    found, dark = (disparity_map(light, -1.0, 1.0).disparity for light in (views, views / 4))
    assert float((found - dark).abs().quantile(0.95)) < 0.01


def test_light_fields_of_a_batch_have_maps_of_their_own():
    views = torch.stack([local_plane(d) for d in (-0.5, 0.1, 0.7)])[:, None]
    found = disparity_map(views)
    assert found.disparity.shape == found.confidence.shape == (3, 1, 48, 52)
    for i in range(3):
        torch.testing.assert_close(found.disparity[i, 0], disparity_map(views[i, 0]).disparity)


@pytest.mark.parametrize(
    ("dtype", "working"), [(torch.uint8, torch.float32), (torch.float16, torch.float32), (torch.float64, torch.float64)]
)
def test_types_follow_the_input(dtype, working):
    views = local_plane(0.3)
    views = views.to(dtype) if dtype.is_floating_point else (255 * views).round().to(dtype)
    found = disparity_map(views, -1.0, 1.0)
    assert found.disparity.dtype == found.confidence.dtype == working
    assert float((found.disparity - 0.3).abs().median()) < 0.02


def test_no_gradients_pass():
    found = disparity_map(local_plane(0.3).requires_grad_(), -1.0, 1.0)
    assert not found.disparity.requires_grad


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"views": torch.rand(1, 1, 1, 20, 20)}, "more than one view"),
        ({"views": torch.rand(3, 1, 20, 20)}, "no axis empty"),
        ({"first": 1.0, "last": -1.0}, "between a first and a larger last"),
        ({"first": math.nan}, "between a first and a larger last"),
        ({"last": math.inf}, "between a first and a larger last"),
        ({"last": 30.0}, "less than half"),
        ({"radius": -1.0}, "radius"),
        ({"radius": math.nan}, "radius"),
    ],
)
def test_bad_arguments_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        disparity_map(**({"views": torch.rand(3, 3, 1, 20, 20), "first": -0.5, "last": 0.5} | change))


def test_the_real_capture_has_its_animal_before_its_wall_and_its_even_ground_between(lytro):
    views = lfref.read(lytro, encoding="linear").views[..., 30:, 30:370]
    found = disparity_map(views, -1.5, 0.5).disparity
    assert float(found[150:190, 280:330].median()) == pytest.approx(-0.87, abs=0.05)
    assert float(found[15:85, 10:95].median()) == pytest.approx(-0.08, abs=0.05)
    ground = found[300:340, 70:220]
    assert float(((ground > -1.2) & (ground < -0.4)).float().mean()) > 0.95


def test_cameras_anywhere_tell_the_same_disparities():
    spread = torch.tensor([1.6, 0.7], dtype=torch.float64)
    stand = lines.even((5, 5)) * spread + 0.2 * torch.rand(5, 5, 2, dtype=torch.float64)
    sharp = neighbours.smoothed(texture(3, 68, 72), 1.0)
    views = torch.stack([torch.stack([shifted(sharp, 0.6 * place) for place in row]) for row in stand])[
        ..., BORDER:-BORDER, BORDER:-BORDER
    ]
    found = disparity_map(views, positions=stand)
    assert float((found.disparity - 0.6).abs().median()) < 0.005
    assert float(((found.disparity - 0.6).abs() < 0.1).double().mean()) > 0.99
    picture = extended_focus(views, positions=stand)
    assert float((picture - border_off(sharp))[..., 4:-4, 4:-4].abs().mean()) < 0.005
    with pytest.raises(InputError, match="positions must be"):
        disparity_map(views, positions=stand[:4])


@pytest.mark.parametrize("name", ["discs", "dome"])
def test_a_crosshair_of_views_tells_as_much_as_all(name):
    made = simulate(sim30.SCENES[name], outputs=("views", "disparity"))
    middle = torch.arange(7) == 3
    weights = (middle[:, None] | middle).double()
    views = torch.where(weights[:, :, None, None, None] > 0, made.views, torch.nan)
    error = (disparity_map(views, weights=weights).disparity - made.disparity).abs()
    assert float(error.median()) < 0.002
    assert float((error < 0.1).double().mean()) > 0.99


def shifted(image, by):
    """A periodic picture moved by (v, u) pixels: a single view of it."""
    rows, columns = (dirichlet(n, -float(way)) for n, way in zip(image.shape[-2:], by, strict=True))
    return rows @ image @ columns.T


def test_the_range_is_looked_for_within_what_small_views_can_shift():
    views = torch.rand(4, 7, 3, 21, 23)
    assert disparity_map(views).disparity.shape == (21, 23)
