"""Steps between slopes: planes come back to thousandths, and what views hide does not pull."""

import pytest
import torch

from lfref.functional import neighbours, splines
from lfref.refocus.disparity import cost_volume, matching
from lfref.refocus.disparity.cost_volume import grey_views
from tests.refocus.conftest import shifted_views, texture


def plane(disparity, grid=(5, 5)):
    return shifted_views(neighbours.smoothed(texture(1, 64, 72), 1.0), disparity, grid).float()[..., 8:-8, 8:-8]


def refined(views, disparity):
    light = grey_views(views, torch.ones(views.shape[:2]))
    return matching.refine(light, disparity, 1e-3, -1.5, 1.5)


@pytest.mark.parametrize("disparity", [-0.83, 0.04, 0.5, 1.0])
@pytest.mark.parametrize("off", [-0.06, 0.05])
def test_a_plane_comes_back_to_thousandths_borders_included(disparity, off):
    error = (refined(plane(disparity), torch.full((48, 56), disparity + off)) - disparity).abs()
    assert float(error.median()) < 2e-3
    assert float(error.quantile(0.98)) < 0.03


def test_views_that_something_hides_do_not_pull():
    views = plane(0.3, (7, 7))
    views[:, 5:] = 0.9
    error = (refined(views, torch.full((48, 56), 0.34)) - 0.3).abs()
    assert float(error.median()) < 2e-3


def test_flat_views_keep_what_was_known():
    known = torch.full((20, 22), 0.4)
    torch.testing.assert_close(refined(torch.full((3, 3, 1, 20, 22), 0.5), known), known, atol=1e-5, rtol=0)


def test_nothing_leaves_the_range():
    light = grey_views(plane(0.5), torch.ones(5, 5))
    assert float(matching.refine(light, torch.full((48, 56), 0.45), 1e-3, 0.4, 0.46).max()) <= 0.46 + 1e-6


@pytest.mark.parametrize("noise", [0.005, 0.03, 0.06])
def test_noise_of_each_view_is_not_taken_for_information(noise):
    still = plane(0.3, (7, 7))
    views = still + noise * torch.randn(still.shape, generator=torch.Generator().manual_seed(1))
    light = grey_views(views, torch.ones(7, 7))
    spread = cost_volume.spread(light, noise).numpy()
    tried = torch.full((48, 56), 0.34)
    information, steps = matching.gauss_newton(light, splines.coefficients(light.samples), tried.numpy(), spread)
    inner = (slice(8, -8), slice(8, -8))
    step = float((information * steps)[inner].sum() / information[inner].sum())
    # Views that differ by chance weigh less, which halves steps; gradients of each view alone left .27 of them.
    assert -0.04 < step < -0.35 * 0.04
