"""Matching: path costs by their recurrence written out, planes to thousandths, the smooth map of a dense solver."""

import itertools

import numpy as np
import pytest
import torch

from lfref.functional import neighbours, splines
from lfref.refocus.disparity import cost_volume, matching
from lfref.refocus.disparity.cost_volume import grey_views
from tests.refocus.conftest import shifted_views, texture


def slow_paths(costs, jumps, step):
    """L_r of one direction by the module's recurrence, pixel by pixel from the border on, [H, W, N]."""
    (height, width, n_labels), (down, right) = costs.shape, step
    path = np.zeros(costs.shape)
    for y, x in itertools.product(range(height)[:: down or 1], range(width)[:: right or 1]):
        path[y, x] = costs[y, x]
        if 0 <= y - down < height and 0 <= x - right < width:
            before = path[y - down, x - right]
            for n in range(n_labels):
                beside = [before[m] + matching.CHANGE for m in (n - 1, n + 1) if 0 <= m < n_labels]
                path[y, x, n] += min(before[n], *beside, before.min() + jumps[y, x]) - before.min()
    return path


@pytest.mark.parametrize("size", [(11, 17), (1, 6), (7, 1)])
def test_paths_from_four_directions_cost_what_the_recurrence_says(size):
    costs, picture = torch.rand(6, *size), torch.rand(size)
    mean = torch.cat([picture.diff(dim=axis).abs().flatten() for axis in (0, 1)]).mean()
    expected = np.zeros((*size, 6))
    for step in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        difference = (picture - picture.roll(step, (0, 1))).abs() / mean
        jumps = np.maximum(matching.JUMP / (1 + difference.numpy() / matching.EDGE), matching.CHANGE)
        expected += slow_paths(costs.permute(1, 2, 0).numpy(), jumps, step)
    found = matching.aggregate(costs, picture).permute(1, 2, 0)
    np.testing.assert_allclose(found, expected, atol=1e-4)


@pytest.mark.parametrize("size", [(40, 50), (70, 150)])
def test_stretches_of_lines_are_followed_alike_by_the_loop_and_by_pytorch(size, monkeypatch):
    costs, picture = torch.rand(9, *size), torch.rand(size)
    compiled = matching.aggregate(costs, picture)
    monkeypatch.setattr(matching, "is_known", lambda *tensors: False)
    torch.testing.assert_close(matching.aggregate(costs, picture), compiled, atol=1e-4, rtol=0)


def plane(disparity, grid=(5, 5)):
    return shifted_views(neighbours.smoothed(texture(1, 64, 72), 1.0), disparity, grid).float()[:, :, 0, 8:-8, 8:-8]


def refined(views, disparity):
    light = grey_views(views, torch.ones(views.shape[:2]))
    return matching.refine(light, disparity, torch.tensor(1e-3), -1.5, 1.5)


@pytest.mark.parametrize("disparity", [-0.35, 0.2])
def test_planes_are_matched_between_slopes_with_confidence(disparity):
    light = grey_views(plane(disparity), torch.ones(5, 5))
    tried = matching.even_slopes(*torch.tensor([-1.0, 1.0], dtype=torch.float64), 2.0)
    labels, confidence = matching.best_slopes(light, tried, torch.zeros(()))
    assert float((labels - disparity)[4:-4, 4:-4].abs().quantile(0.95)) < 0.05
    assert float(confidence[4:-4, 4:-4].median()) > 0.4
    assert float(confidence.max()) < 1


@pytest.mark.parametrize(("disparity", "off"), [(-0.83, 0.05), (0.04, -0.06), (1.0, -0.06)])
def test_a_plane_comes_back_to_thousandths_borders_included(disparity, off):
    error = (refined(plane(disparity), torch.full((48, 56), disparity + off)) - disparity).abs()
    assert float(error.median()) < 2e-3
    assert float(error.quantile(0.98)) < 0.03


@pytest.mark.parametrize("noise", [0.005, 0.06])
def test_noise_of_each_view_is_not_taken_for_information(noise):
    still = plane(0.3, (7, 7))
    views = still + noise * torch.randn(still.shape, generator=torch.Generator().manual_seed(1))
    light = grey_views(views, torch.ones(7, 7))
    spread = cost_volume.spread(light, torch.tensor(noise)).numpy()
    tried = torch.full((48, 56), 0.34)
    information, steps = matching.gauss_newton(
        light, splines.coefficients(light.samples.numpy()), tried.numpy(), spread
    )
    inner = (slice(8, -8), slice(8, -8))
    step = float((information * steps)[inner].sum() / information[inner].sum())
    # Views that differ by chance weigh less, which halves steps; gradients of each view alone left .27 of them.
    assert -0.04 < step < -0.35 * 0.04


def dense(target, trust, across, down):
    """The smooth map by a dense system of equations."""
    height, width = target.shape
    matrix, number = torch.diag(trust.flatten()), torch.arange(height * width).reshape(height, width)
    pairs = [(number[:, :-1], number[:, 1:], across[:, :-1]), (number[:-1], number[1:], down[:-1])]
    for first, second, tie in pairs:
        for a, b, t in zip(first.flatten(), second.flatten(), tie.flatten(), strict=True):
            matrix[a, a] += t
            matrix[b, b] += t
            matrix[a, b] -= t
            matrix[b, a] -= t
    return torch.linalg.solve(matrix, (trust * target).flatten()).reshape(height, width)


@pytest.mark.parametrize("size", [(6, 7), (1, 9), (8, 1)])
def test_enough_rounds_solve_the_equations(size, monkeypatch):
    monkeypatch.setattr(matching, "ROUNDS", 2000)
    maps = torch.rand(4, *size, dtype=torch.float64)
    torch.testing.assert_close(matching.relax(*maps), dense(*maps), atol=1e-6, rtol=0)
