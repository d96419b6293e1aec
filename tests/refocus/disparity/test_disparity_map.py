"""Disparity maps: planes and simulated scenes come back; the estimated range; which sign is nearer."""

import itertools
import math

import pytest
import torch

from lfref.errors import InputError
from lfref.functional import neighbours
from lfref.refocus import batches
from lfref.refocus.disparity import disparity_map as module
from lfref.refocus.disparity.disparity_map import coarse_disparity, disparity_map, estimate_range, order_score
from lfref.refocus.focus.all_in_focus import extended_focus
from lfref.refocus.focus.line_range import wide_range
from lfref.refocus.fourier import energies
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate
from tests.refocus.conftest import dirichlet, shifted_views, texture

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


@pytest.mark.parametrize(("disparity", "grid"), [(-0.83, (7, 7)), (0.0, (6, 5)), (0.04, (7, 7)), (0.61, (6, 5))])
def test_a_plane_comes_back_at_every_pixel(disparity, grid):
    error = (disparity_map(local_plane(disparity, grid), -1.2, 1.2).disparity - disparity).abs()
    # Interpolation blurs, which pulls towards slopes at which shifts are whole.
    assert float(error.median()) < 0.02
    assert float(error.quantile(0.95)) < 0.08
    assert float((error[is_border(error.shape)] > 0.1).float().mean()) < 0.1


@pytest.mark.parametrize("name", ["plane", "leaves"])
def test_simulated_scenes_come_back_borders_included(name):
    simulated = simulate(sim30.SCENES[name], outputs=["views", "disparity"])
    error = (disparity_map(simulated.views).disparity - simulated.disparity).abs()
    assert float(error.median()) < 0.02
    assert float((error > 0.1).float().mean()) < 0.1
    assert float((error[is_border(error.shape, 24)] > 0.5).float().mean()) < 0.1


@pytest.mark.parametrize(
    "change",
    [
        {"views": torch.rand(1, 1, 1, 20, 20)},
        {"views": torch.rand(3, 1, 20, 20)},
        {"first": 1.0, "last": -1.0},
        {"first": math.nan},
        {"last": 30.0},
        {"positions": torch.zeros(2, 3, 2)},
    ],
)
def test_bad_arguments_are_refused(change):
    with pytest.raises(InputError):
        disparity_map(**({"views": torch.rand(3, 3, 1, 20, 20), "first": -0.5, "last": 0.5} | change))


def moved(image, by):
    """A periodic picture moved by (v, u) pixels: a single view of it."""
    rows, columns = (dirichlet(n, -float(way)) for n, way in zip(image.shape[-2:], by, strict=True))
    return rows @ image @ columns.T


def test_cameras_anywhere_show_the_same_disparities():
    spread = torch.tensor([1.6, 0.7], dtype=torch.float64)
    cameras = batches.even((5, 5)) * spread + 0.2 * torch.rand(5, 5, 2, dtype=torch.float64)
    sharp = neighbours.smoothed(texture(3, 68, 72), 1.0)
    views = border_off(torch.stack([torch.stack([moved(sharp, 0.6 * at) for at in row]) for row in cameras]))
    error = (disparity_map(views, positions=cameras).disparity - 0.6).abs()
    assert float(error.median()) < 0.005
    assert float((error < 0.1).double().mean()) > 0.99
    picture = extended_focus(views, positions=cameras)
    assert float((picture - border_off(sharp))[..., 4:-4, 4:-4].abs().mean()) < 0.005


@pytest.mark.parametrize("name", ["leaves", "twigs", "deep", "wall"])
def test_the_estimated_range_holds_what_the_central_view_shows(name):
    simulated = simulate(sim30.SCENES[name], outputs=["views", "disparity"])
    views, aperture = simulated.views, batches.checked_weights(None, (7, 7))
    grey, known = views.mean(2), wide_range(views, aperture)
    low, high = estimate_range(grey, aperture, energies.farthest(known), energies.energy_range(grey, aperture, known))
    inside = (simulated.disparity > low) & (simulated.disparity < high)
    assert float(inside.float().mean()) > 0.98
    assert high - low < 1.4 * float(simulated.disparity.max() - simulated.disparity.min()) + 0.6


@pytest.fixture(scope="module")
def cards():
    """Cards at three depths, larger disparities nearer, and their true disparity."""
    simulated = simulate(sim30.SCENES["shards"], 0, ("views", "disparity"))
    return simulated.views, simulated.disparity.float()


def test_larger_disparities_are_nearer_in_simulated_fields_and_smaller_ones_with_both_axes_reversed(cards):
    views, disparity = cards
    sure = torch.ones_like(disparity)
    assert order_score(views, disparity, sure) > 0.5
    assert order_score(views.flip(0, 1), -disparity, sure) < -0.5
    assert order_score(views, *disparity_map(views)) > 0.5


@pytest.mark.parametrize("kind", ["noise", "flat", "one view"])
def test_where_nothing_hides_anything_there_is_no_order(kind):
    views = torch.rand(5, 5, 3, 40, 48) if kind != "flat" else torch.full((5, 5, 3, 40, 48), 0.5)
    views = views[:1, :1] if kind == "one view" else views
    disparity = torch.rand(40, 48)
    assert abs(order_score(views, disparity, torch.ones(40, 48))) < 0.5


def test_a_light_is_refocused_where_it_is_although_weak_texture_outvotes_it(monkeypatch):
    textured = shifted_views(texture(3, 72, 96), -1.0, (7, 7))
    y, x = torch.arange(72.0)[:, None], torch.arange(96.0)
    views = 0.1 + 0.1 * textured.float()
    for v, u in itertools.product(range(7), repeat=2):
        distance = (y - 36 + 0.6 * (v - 3)).hypot(x - 48 + 0.6 * (u - 3))
        views[v, u] += 4 * (5 - distance).clamp(0, 1)
    far, inside = is_border((72, 96), 8), (y - 36).hypot(x - 48) < 4
    grey = views.mean(2)
    held = energies.energy_range(grey, batches.checked_weights(None, (7, 7)), None)
    disparity = coarse_disparity(grey, None, held)
    monkeypatch.setattr(module, "LIGHT", math.inf)  # nothing is a light
    voted = coarse_disparity(grey, None, held)
    assert float((voted[inside] + 0.6).abs().median()) > 0.2
    assert float((disparity[inside] + 0.6).abs().median()) < 0.06
    around = (y - 36).hypot(x - 48) < 14
    assert torch.equal(disparity[~around], voted[~around])
    assert float((disparity[~around & ~far] + 1).abs().median()) < 0.05
