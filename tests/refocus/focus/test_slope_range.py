"""Slope ranges: the fit of a library, coarse disparity of planes, ranges of scenes."""

import pytest
import torch
from torch.nn import functional as F

from lfref.refocus.focus import slope_range as module
from lfref.refocus.focus.slope_range import (
    CoarseDisparity,
    disparity_of_reduced,
    reduce_views,
    scene_range,
    slope_range,
)
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate
from tests.refocus.conftest import layered_views, shifted_views, texture


def coarse(views, weight=None, positions=None):
    return disparity_of_reduced(reduce_views(views, weight, positions))


def plane(disparity, grid=(5, 5)):
    return shifted_views(texture(1, 96, 120), disparity, grid)


def error(coarse_disparity, disparity, border=12):
    """Median over the interior."""
    inside = slice(border, -border)
    return float((coarse_disparity.disparity[inside, inside] - disparity).abs().median())


def test_smooth_gains_are_taken_out_and_parallax_is_left():
    views = shifted_views(texture(1, 96, 120), 0.5, (5, 5)) + 0.2
    gain = 1 - 0.3 * torch.linspace(-1, 1, 120).square() * torch.arange(-2, 3)[:, None, None, None].square() / 4
    plain, evened = reduce_views(views), reduce_views(views * gain)
    torch.testing.assert_close(evened.pictures, plain.pictures, rtol=0.02, atol=0.01)
    # Without shading, nothing is touched.
    grey = views.mean(2).float().clamp(min=0).sqrt()
    for picture, (v, u) in zip(plain.pictures, plain.indices, strict=True):
        torch.testing.assert_close(picture, grey[v, u], rtol=1e-5, atol=1e-6)


STEPS = torch.tensor([[0.0, 0.0], [0.0, -1.0], [0.0, 1.0], [-1.0, 0.0], [2.0, 1.0]], dtype=torch.float64)


def fit_at(pictures, slope, pad=4):
    light, weights = (F.pad(maps, (pad,) * 4) for maps in (pictures, torch.ones_like(pictures)))
    (fit,) = module.fit_slopes(light, weights, STEPS, torch.tensor([slope], dtype=torch.float64), 10.0, pad)
    return fit


@pytest.mark.parametrize("slope", [0.0, 1.0, 0.6])
def test_the_fit_is_that_of_a_library(slope, monkeypatch):
    monkeypatch.setattr(module, "SKIRT", 0.0)
    ramp = torch.arange(24.0)
    smooth = torch.sin(ramp[:, None] / 3) + torch.cos(ramp / 2.5) + 0.02 * torch.randn(5, 24, 24)
    fit = fit_at(smooth, slope)
    shifts = (slope * STEPS).round().long()
    moved = torch.stack([torch.roll(p, tuple((-t).tolist()), (0, 1)) for p, t in zip(smooth, shifts, strict=True)])
    mean = moved.mean(0)
    # Derivatives of the mean by the same five points, written down for the middle pixel's window.
    rows, columns = (
        (8 * (mean.roll(-1, a) - mean.roll(1, a)) - mean.roll(-2, a) + mean.roll(2, a)) / 12 for a in (0, 1)
    )
    window = slice(10, 15), slice(10, 15)
    remainders = (slope * STEPS - shifts).float()
    p, e = (offsets - offsets.mean(0) for offsets in (STEPS.float(), remainders))
    along = torch.stack([p[k, 0] * rows[window] + p[k, 1] * columns[window] for k in range(5)]).flatten()
    lacking = torch.stack([e[k, 0] * rows[window] + e[k, 1] * columns[window] for k in range(5)]).flatten()
    change = (moved - mean)[:, *window].flatten() + lacking
    solved = torch.linalg.lstsq(-along[:, None], change).solution[0]
    assert float(fit.disparity[12, 12]) == pytest.approx(slope + float(solved), abs=1e-4)
    left = (change + along * solved).square().sum() / 25 / 4
    assert float(fit.unexplained[12, 12]) == pytest.approx(float(left), rel=1e-3)


@pytest.mark.parametrize("disparity", [-3.4, -0.3, 0.0, 0.55])
def test_a_plane_comes_back_with_confidence(disparity):
    found = coarse(plane(disparity))
    assert error(found, disparity) < 0.03
    assert float((found.confidence > 0.5).float().mean()) > 0.9


@pytest.mark.parametrize("grid", [(1, 7), (7, 1), (2, 2), (14, 14)])
def test_grids_of_all_kinds_will_do(grid):
    assert error(coarse(plane(0.7, grid)), 0.7) < 0.03


def test_cameras_may_be_spaced_unevenly_and_counted_in_other_units():
    columns = torch.tensor([-2.0, -1.25, 0.0, 0.5, 2.0], dtype=torch.float64)
    image = texture(1, 96, 120)
    views = torch.stack([shifted_views(image, 0.8 * float(u), (1, 3))[:, 2] for u in columns], 1)
    positions = torch.stack([torch.zeros(1, 5, dtype=torch.float64), columns[None]], -1)
    for unit in (1, 20, 0.1):
        assert error(coarse(views, positions=unit * positions), 0.8 / unit) < 0.04 / unit


@pytest.mark.parametrize(
    "name", ["shards", "discs", "crossing", "dome", "deep", "everything", "wide_near_9", "wide_both_7"]
)
def test_the_range_covers_a_scene_and_is_hardly_wider(name):
    made = simulate((sim30.SCENES | sim30.WIDE)[name], outputs=["views", "disparity"])
    low, high = slope_range(coarse(made.views))
    # A plane's range is a single number.
    assert float(((made.disparity >= low - 0.02) & (made.disparity <= high + 0.02)).float().mean()) > 0.98
    first, last = made.disparity.flatten().quantile(torch.tensor([0.01, 0.99])).tolist()
    assert high - low < 1.3 * max(last - first, 0.1)
    if name in sim30.WIDE:
        to_search = scene_range(made.views)
        assert not to_search.is_ambiguous
        assert to_search.low < float(made.disparity.min()) < float(made.disparity.max()) < to_search.high


def test_strays_and_unsure_pixels_are_left_out():
    disparity = torch.linspace(-1, 1, 100).expand(100, 100).clone()
    disparity[50, 50] = 30.0
    confidence = torch.ones(100, 100)
    confidence[:, :25] = 0.1
    low, high = slope_range(CoarseDisparity(disparity, confidence, 1, confidence > 0))
    assert low == pytest.approx(-0.5, abs=0.1)
    assert high == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    "views", [torch.full((5, 5, 3, 40, 50), 0.3), torch.rand(1, 1, 3, 40, 50), torch.rand(7, 7, 3, 128, 192)]
)
def test_flat_views_single_views_and_noise_have_no_range(views):
    assert slope_range(coarse(views)) is None


@pytest.mark.parametrize(("near", "far"), [(0.9, -0.4), (8.2, -3.1), (-6.7, -9.4), (9.5, 1.3)])
def test_the_range_to_search_holds_all_surfaces_at_any_baseline(near, far):
    torch.manual_seed(1)
    views = layered_views(near, far, (144, 160))[0].float()
    low, middle, high, *_ = scene_range(views)
    assert low < min(near, far) < middle < max(near, far) < high
    assert high - low < 1.5 * abs(near - far) + 2 * 2  # a quarter at either end, and half of a pixel reduced by 2


def test_a_small_surface_counts_for_the_range_to_search():
    torch.manual_seed(2)
    views = shifted_views(texture(1, 144, 160), 0.5, (5, 5)).float()
    twig = shifted_views(texture(1, 144, 160), 7.0, (5, 5)).float()
    offsets = 7 * (torch.arange(5) - 2)
    for v in range(5):
        for u in range(5):
            rows, columns = slice(60 + offsets[v], 100 + offsets[v]), slice(72 + offsets[u], 88 + offsets[u])
            views[v, u, :, rows, columns] = twig[v, u, :, rows, columns]
    assert scene_range(views).high > 7
    assert scene_range(views).high < 10


def test_sheen_on_a_wall_does_not_move_the_wall():
    # A smooth light that moves as if it lay behind the wall.
    wall = plane(0.5, (7, 7))
    light = torch.exp(-(torch.linspace(-1, 1, 120).square() + torch.linspace(-1, 1, 96)[:, None].square()) / 0.1)
    sheen = shifted_views(light[None].to(wall).repeat(wall.shape[2], 1, 1), 3.0, (7, 7))
    found = coarse(0.5 * wall + 0.5 * sheen)
    low, high = slope_range(found)
    assert (low, high) == pytest.approx((0.5, 0.5), abs=0.35)
    assert error(found, 0.5) < 0.1
