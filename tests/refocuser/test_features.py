"""Features of refocused planes against sums written out, and on simple scenes."""

from dataclasses import replace

import pytest
import torch

from lfref.lightfield import LightField
from lfref.refocus.blockwise_wiener import blockwise_wiener, blockwise_wiener_parts
from lfref.refocus.fourier.disparity_layers import refocus_by_layers
from lfref.refocus.separable_wiener import separable_wiener
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.shift_and_sum_antialiased import shift_and_sum_antialiased
from lfref.refocuser.features import CANDIDATES, FEATURES, candidate, coverage, refiner_inputs
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator import sim30
from lfref.simulator.effects.recording import noisy
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.simulate import simulate
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Noise

BASE = OperatorRefocuser("shift_and_sum", shift_and_sum)
CELLS = OperatorRefocuser("cells", shift_and_sum_antialiased)
SLOPES = torch.tensor([-0.6, 0.4, 2.0], dtype=torch.float64)
STILL = torch.zeros(1, dtype=torch.float64)
CHANNELS = dict.fromkeys(FEATURES, 1) | dict.fromkeys((*CANDIDATES, "picture"), 3) | {"defocus": 2, "relief": 2}


def surface(grid=(5, 5), size=(40, 48), disparity=0.4):
    """A light field of one textured surface."""
    scene = Scene(Camera(grid, size), (Surface(Plane(disparity), Noise((0.5, 0.4, 0.3), (0.3, 0.3, 0.3))),))
    return LightField(simulate(scene, outputs=("views",)).views)


def of(light, slopes=SLOPES, base=BASE):
    """All features by name, with the pictures, their error scale `scale` and the unit of the features."""
    ((features, pictures, scale),) = refiner_inputs(light, slopes, base)
    split = dict(zip(FEATURES, features.split(list(CHANNELS.values()), 1), strict=True))
    return split | {"pictures": pictures, "scale": scale, "unit": scale + 1e-6}


def in_light(made, name):
    """`inner` or `spread` as light: the inverse of the formula."""
    return (3 * made[name]).sinh() * made["unit"]


@pytest.mark.parametrize("grid", [(3, 3), (5, 5), (4, 7)])
def test_all_features_are_finite_at_every_plane_of_any_grid(grid):
    made = of(surface(grid))
    assert {name: made[name].shape[1] for name in FEATURES} == CHANNELS
    assert all(bool(made[name].isfinite().all()) for name in FEATURES)


def test_the_spread_is_the_standard_deviation_over_the_views():
    views = torch.rand(3, 3, 3, 12, 14)
    expected = views.mean(2).flatten(0, 1).std(0, correction=0)
    torch.testing.assert_close(in_light(of(LightField(views), STILL), "spread")[0, 0], expected, atol=1e-4, rtol=1e-3)


def test_defocus_is_the_slope_less_the_disparity():
    made = of(surface())["defocus"][..., 10:-10, 10:-10]
    for (first, second), slope in zip(made, SLOPES.tolist(), strict=True):
        assert float((first.atanh() - (slope - 0.4)).abs().median()) < 0.02
        assert float((second.atanh() / 0.3 - abs(slope - 0.4)).abs().median()) < 0.02


def test_coverage_counts_the_views_within_whose_frame_a_pixel_lies():
    expected = torch.zeros(3, 1, 9, 12)
    for plane, slope in enumerate(SLOPES.tolist()):
        for row, column in torch.cartesian_prod(torch.arange(9), torch.arange(12)).tolist():
            at = [(row + slope * (v - 1), column + slope * (u - 2)) for v in range(3) for u in range(5)]
            expected[plane, 0, row, column] = sum(-1 < y < 9 and -1 < x < 12 for y, x in at) / 15
    views = torch.rand(3, 5, 3, 9, 12)
    torch.testing.assert_close(coverage(SLOPES, views), expected)
    torch.testing.assert_close(of(LightField(views))["coverage"], 2 * (1 - expected))


def test_inner_is_the_middle_of_the_aperture_less_all_of_it():
    views = torch.rand(5, 5, 3, 12, 14)
    weights = torch.tensor([0.0, 0.75, 1.0, 0.75, 0.0])
    weights = weights[:, None] * weights / weights.sum() ** 2
    grey = views.mean(2)
    expected = torch.einsum("vu,vuhw->hw", weights, grey) - grey.mean((0, 1))
    torch.testing.assert_close(in_light(of(LightField(views), STILL), "inner")[0, 0], expected, atol=1e-4, rtol=1e-3)


@pytest.mark.parametrize(
    ("rows", "columns"),
    [(slice(1, None, 2), slice(0, None, 2)), (slice(0, None, 2), slice(1, None, 2))],
    ids=["5x6", "6x5"],
)
def test_the_central_view_is_known_whether_a_camera_stands_there_or_not(rows, columns):
    # Every second of eleven views are five with one in the middle, or six with none.
    scene = replace(sim30.SCENES["dome"], camera=Camera(grid=(11, 11), size=(72, 80)))
    dense = simulate(scene, outputs=("views",)).views
    made = of(LightField(dense[rows, columns].contiguous()))
    # A candidate is x / (1 + |x| / 3) times the unit, x the difference from the picture in units.
    x = made["central"] / (1 - made["central"].abs() / 3)
    central = made["pictures"] + x * made["unit"]
    is_exact = (made["central"].abs() < 2) & (made["scale"] > 1e-3)
    error = (central - dense[5, 5])[is_exact].square().mean()
    assert int(is_exact.sum()) > 3000
    assert float(-10 * error.log10()) > 40


@pytest.mark.parametrize(("base", "others", "planes"), [(BASE, ("sum", "cells"), (0, 1)), (CELLS, ("sum",), (2,))])
def test_the_error_scale_is_the_mean_distance_to_the_nearer_other_picture_and_noise(base, others, planes):
    light, (row, column) = surface(), (20, 24)
    made = of(light, base=base)
    stacks = {"sum": shift_and_sum(light.views, SLOPES, "cubic"), "cells": CELLS(light, SLOPES)}
    apart = torch.stack([(stacks[name] - made["pictures"]).abs() for name in others]).amin(0).mean(1)
    noise = 10 ** (2 * (made["noise"] - 1.5)) - 1e-6
    for plane in planes:
        nearer = apart[plane, row - 2 : row + 3, column - 2 : column + 3].mean()
        assert float(nearer) > 1e-5
        expected = nearer.hypot(noise[plane, 0, row, column])
        torch.testing.assert_close(made["scale"][plane, 0, row, column], expected, rtol=1e-3, atol=1e-6)
    torch.testing.assert_close(made["error_scale"], made["unit"].log10() / 2 + 1.5)


def test_noise_is_what_the_mean_of_the_views_keeps_of_it():
    views = noisy(torch.full((5, 5, 3, 160, 160), 0.4), 1e-3, 1e-4, torch.randn(5, 5, 3, 160, 160))
    for base, tolerance in ((BASE, 0.1), (BASE.through(lambda grid: torch.eye(5).maximum(torch.eye(5).flip(0))), 0.2)):
        made = of(LightField(views), STILL, base)
        noise = 10 ** (2 * (made["noise"] - 1.5))
        assert float(noise.mean()) == pytest.approx(float(made["pictures"].std()), rel=tolerance)


def test_everywhere_is_the_picture_of_the_separable_wiener_estimate():
    slopes, light = torch.tensor([-0.33, 6.0], dtype=torch.float64), surface()
    made = of(light, slopes, CELLS)
    expected = candidate(separable_wiener(light.views, slopes), made["pictures"], made["unit"])
    torch.testing.assert_close(made["everywhere"], expected, atol=1e-3, rtol=0)
    # Of its own picture, `blockwise_wiener` has the part at hand.
    made = of(light, slopes, OperatorRefocuser("blockwise_wiener", blockwise_wiener))
    expected = candidate(blockwise_wiener_parts(light.views, slopes)[:, 3:], made["pictures"], made["unit"])
    torch.testing.assert_close(made["everywhere"], expected, atol=1e-3, rtol=0)


def test_far_from_focus_blur_by_surfaces_is_not_corrected():
    slopes = torch.tensor([0.3, 4.1, 6.0], dtype=torch.float64)
    light = surface()
    for base in (
        OperatorRefocuser("blockwise_wiener", blockwise_wiener),
        OperatorRefocuser("layers", refocus_by_layers),
    ):
        made = of(light, slopes, base)
        full = 10 ** (2 * (made["error_scale"] - 1.5))
        inner = (..., slice(20, -20), slice(20, -20))
        torch.testing.assert_close(made["scale"][0], full[0] - 1e-6, atol=1e-6, rtol=1e-3)
        share = (made["scale"][1] / full[1])[inner]
        torch.testing.assert_close(share, torch.full_like(share, (4.5 - 3.7) / 1.5), atol=0.05, rtol=0)
        assert not made["scale"][2].any()
    # Sums have copies there, which may be corrected.
    assert of(light, slopes, CELLS)["scale"][2].any()
