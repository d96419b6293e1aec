"""Disparity at a glance: planes and edges are found, through noise, shading, holes and grids of all kinds."""

import pytest
import torch

from lfref.refocus.focus import slope_range
from lfref.refocus.focus.slope_range import CoarseDisparity, disparity_of_reduced
from tests.refocus.conftest import shifted_views, texture


def seen(
    views: torch.Tensor, weight: torch.Tensor | None = None, positions: torch.Tensor | None = None
) -> CoarseDisparity:
    return disparity_of_reduced(slope_range.reduce_views(views, weight, positions))


def plane(disparity: float, grid: tuple[int, int] = (5, 5), channels: int = 1) -> torch.Tensor:
    return shifted_views(texture(channels, 96, 120), disparity, grid)


def error(found: CoarseDisparity, disparity: float, border: int = 12) -> float:
    """Median over the interior."""
    inside = slice(border, -border)
    return float((found.disparity[inside, inside] - disparity).abs().median())


@pytest.mark.parametrize("disparity", [-3.4, -1.0, -0.3, 0.0, 0.55, 2.0])
def test_a_plane_is_found_and_believed(disparity):
    found = seen(plane(disparity))
    assert error(found, disparity) < 0.03
    assert float((found.confidence > 0.5).float().mean()) > 0.9


@pytest.mark.parametrize("grid", [(1, 7), (7, 1), (3, 3), (2, 2), (14, 14), (3, 9)])
def test_grids_of_all_kinds_will_do(grid):
    assert error(seen(plane(0.7, grid)), 0.7) < 0.03


def test_two_planes_meet_at_an_edge():
    views = torch.where(torch.arange(120) < 60, plane(0.5), plane(-1.0))
    found = seen(views).disparity
    assert (found[12:-12, 12:50] - 0.5).abs().median() < 0.02
    assert (found[12:-12, 70:-12] + 1.0).abs().median() < 0.02


def test_large_views_are_reduced_and_disparities_stay_in_their_pixels():
    torch.manual_seed(3)
    views = plane(1.0, (3, 3)).repeat_interleave(4, -1).repeat_interleave(4, -2)
    found = seen(views)
    assert found.factor > 1
    assert error(found, 4.0) < 0.15


def test_noise_widens_the_error_and_lowers_the_confidence():
    views = plane(0.6)
    noisy = views + 0.15 * torch.randn_like(views)
    assert error(seen(noisy), 0.6) < 0.1
    assert seen(noisy).confidence.mean() < seen(views).confidence.mean()


def test_vignetting_and_exposure_are_not_taken_for_motion():
    views = plane(0.4)
    y, x = torch.meshgrid(torch.linspace(-1, 1, 96), torch.linspace(-1, 1, 120), indexing="ij")
    steps = torch.arange(5) - 2.0
    fall = (x + 0.3 * steps[:, None, None]).square() + (y + 0.3 * steps[:, None, None, None]).square()
    assert error(seen(views * (1 - 0.2 * fall)[:, :, None]), 0.4) < 0.03


def test_a_hole_and_views_that_are_black_are_not_read():
    views, weight = plane(0.5), torch.ones(5, 5, 1, 96, 120)
    views[2, 3], weight[2, 3] = torch.nan, 0
    views[0, 2] = 0
    assert error(seen(views, weight), 0.5) < 0.02
    views[2, 2], weight[2, 2] = torch.nan, 0
    assert error(seen(views, weight), 0.5) < 0.02


def test_only_diagonals_are_enough():
    weight = torch.eye(5)[:, :, None, None, None].expand(5, 5, 1, 96, 120)
    assert error(seen(plane(0.5) * weight, weight), 0.5) < 0.03


def test_cameras_may_be_spaced_unevenly():
    columns = torch.tensor([-2.0, -1.25, 0.0, 0.5, 2.0], dtype=torch.float64)
    image = texture(1, 96, 120)
    views = torch.stack([shifted_views(image, 0.8 * float(u), (1, 3))[:, 2] for u in columns], 1)
    positions = torch.stack([torch.zeros(1, 5, dtype=torch.float64), columns[None]], -1)
    assert error(seen(views, positions=positions), 0.8) < 0.03


@pytest.mark.parametrize("views", [torch.full((5, 5, 3, 40, 50), 0.3), torch.zeros(3, 3, 1, 40, 50)])
def test_nothing_to_be_seen_is_0_and_not_believed(views):
    found = seen(views)
    assert found.disparity.abs().max() == 0
    assert found.confidence.max() < 0.01


@pytest.mark.parametrize("rubbish", [torch.nan, torch.inf])
def test_samples_that_are_not_finite_are_passed_over(rubbish):
    views = plane(0.5)
    views[2, :, 0, 40:44, 50:54] = rubbish
    found = seen(views)
    assert bool(found.disparity.isfinite().all() and found.confidence.isfinite().all())
    assert error(found, 0.5) < 0.02
    assert seen(torch.full_like(views, rubbish)).confidence.max() == 0


@pytest.mark.parametrize(
    "shape", [(1, 1, 3, 40, 50), (5, 5, 3, 1, 64), (5, 5, 3, 64, 1), (5, 5, 1, 2, 2), (5, 5, 1, 3, 5)]
)
def test_one_view_and_single_pixels_end_in_a_map(shape):
    found = seen(torch.rand(shape))
    assert bool(found.disparity.isfinite().all())


def test_integers_are_scaled():
    views = (plane(0.5) * 255).round().to(torch.uint8)
    assert error(seen(views), 0.5) < 0.02


def test_positions_in_other_units_only_scale_disparities():
    places = torch.stack(torch.meshgrid(torch.arange(5.0), torch.arange(5.0), indexing="ij"), -1).double() - 2
    views = plane(0.5)
    assert error(seen(views, positions=20 * places), 0.5 / 20) < 0.002
    assert error(seen(views, positions=0.1 * places), 5.0) < 0.3
