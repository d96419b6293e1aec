"""The range of disparities at a glance: planes are found, sizes and types make no difference, nothing seen is 0."""

import pytest
import torch

from lfref.refocus import lines
from lfref.refocus.disparity.disparity_range import disparity_range
from tests.refocus.conftest import shifted_views, texture


def smooth_views(disparity: float, grid: tuple[int, int] = (7, 7), side: int = 160) -> torch.Tensor:
    """A plane of soft texture, which small pictures of the views still show."""
    torch.manual_seed(5)
    waves = texture(1, side // 8, side // 8)[:, :, None, :, None].expand(-1, -1, 8, -1, 8)
    soft = torch.fft.rfft2(waves.reshape(1, side, side))
    soft[..., side // 16 : -(side // 16), :] = 0
    soft[..., side // 16 :] = 0
    return shifted_views(torch.fft.irfft2(soft, s=(side, side)), disparity, grid)


@pytest.mark.parametrize("disparity", [-3.0, -1.0, 0.0, 0.4, 2.0])
def test_one_plane_is_found(disparity):
    seen = disparity_range(smooth_views(disparity))
    assert seen.low - 0.01 <= seen.middle <= seen.high + 0.01
    assert seen.middle == pytest.approx(disparity, rel=0.25, abs=0.02)


def test_two_planes_span_a_range():
    near, far = smooth_views(0.5), smooth_views(-1.0)
    views = torch.where(torch.arange(160) < 80, near, far)
    seen = disparity_range(views)
    assert seen.low < -0.7
    assert seen.high > 0.3


@pytest.mark.parametrize("grid", [(1, 7), (7, 1)])
def test_one_row_or_column_of_views_is_enough(grid):
    assert disparity_range(smooth_views(1.0, grid)).middle == pytest.approx(1.0, rel=0.25)


@pytest.mark.parametrize("views", [torch.full((5, 5, 3, 40, 50), 0.3), torch.rand(1, 1, 3, 40, 50)])
def test_nothing_seen_is_0(views):
    assert disparity_range(views) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("rubbish", [torch.nan, torch.inf])
def test_samples_that_are_not_finite_make_no_range(rubbish):
    views = smooth_views(1.0)
    views[3, 3, 0, 80, 80] = rubbish
    assert disparity_range(views) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("size", [(1, 64), (64, 1)])
def test_a_single_row_or_column_of_pixels_will_do(size):
    assert all(value == value for value in disparity_range(torch.rand(5, 5, 3, *size)))


def test_views_of_weight_0_are_not_looked_at():
    views, weights = smooth_views(1.0), torch.ones(7, 7)
    weights[3, 1:4], weights[0, 3] = 0, 0
    expected = disparity_range(views, weights)
    assert expected.middle == pytest.approx(1.0, rel=0.25)
    for rubbish in (torch.nan, 7.0):
        assert disparity_range(torch.where(weights[..., None, None, None] > 0, views, rubbish), weights) == expected


def test_a_cross_of_views_is_enough():
    weights = torch.zeros(7, 7)
    weights[4], weights[:, 2] = 1, 1
    assert disparity_range(smooth_views(-1.0), weights).middle == pytest.approx(-1.0, rel=0.25)


def test_disparities_are_per_step_wherever_cameras_stand():
    views, stand = smooth_views(0.5, (9, 9)), lines.even((9, 9))
    taken = (torch.tensor([0, 1, 4, 6, 8])[:, None], torch.tensor([0, 3, 4, 5, 8]))
    found = disparity_range(views[taken], None, stand[taken] + 0.1)
    assert found.middle == pytest.approx(0.5, rel=0.25)
    half_as_far = disparity_range(views[taken], None, stand[taken] / 2)
    assert half_as_far.middle == pytest.approx(2 * found.middle, rel=1e-4)
