"""Focus on surfaces and by homographies: the definition in plain Python, and slanted planes known exactly."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck

from lfref.errors import InputError
from lfref.refocus import batches
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.surface import homography, per_pixel, tilt_shift
from tests.refocus.slow import slow_mean, slow_shift_and_sum

BORDERS = ["renormalize", "edge", "zero", "wrap"]
LOCAL = ["nearest", "linear", "cubic"]


def smooth_texture(x: Tensor, y: Tensor) -> Tensor:
    """A texture known at every point, about 0.5, no wave shorter than 5.6 pixels."""
    waves = [(0.14, 0.05, 0.3), (-0.07, 0.16, 1.1), (0.17, -0.03, 2.0), (0.13, 0.12, 4.0)]
    return 0.5 + sum(0.1 * torch.cos(2 * torch.pi * (kx * x + ky * y) + phase) for kx, ky, phase in waves)


def slanted_views(start: float, tilt: tuple[float, float], grid: tuple[int, int], size: tuple[int, int]) -> Tensor:
    """Views of a texture on the plane of disparity d(X, Y) = start + a X + b Y, X and Y pixels of the middle view.

    A point (X, Y) is seen at x = X + d u', y = Y + d v': a linear map for each view, which is solved for X and Y.
    """
    (a, b), (height, width) = tilt, size
    x, y = torch.arange(width).double(), torch.arange(height).double()[:, None]
    views = torch.empty(*grid, 1, *size, dtype=torch.float64)
    for v, u in np.ndindex(*grid):
        right, down = u - (grid[1] - 1) / 2, v - (grid[0] - 1) / 2
        forward = torch.tensor([[1 + a * right, b * right], [a * down, 1 + b * down]]).double()
        back = torch.linalg.inv(forward)
        from_x, from_y = x - start * right, y - start * down
        views[v, u, 0] = smooth_texture(
            back[0, 0] * from_x + back[0, 1] * from_y, back[1, 0] * from_x + back[1, 1] * from_y
        )
    return views


def decibels(image: Tensor, truth: Tensor, margin: int = 8) -> float:
    inside = (..., slice(margin, -margin), slice(margin, -margin))
    return float(-10 * (image - truth)[inside].square().mean().log10())


@pytest.mark.parametrize("border", BORDERS)
@pytest.mark.parametrize(("interpolation", "grid"), [("nearest", (3, 4)), ("linear", (2, 5)), ("cubic", (3, 2))])
def test_equals_the_slow_reference(interpolation, border, grid):
    views = torch.rand(*grid, 2, 6, 8, dtype=torch.float64)
    weights = torch.rand(grid, dtype=torch.float64)
    slope_map = torch.rand(6, 8, dtype=torch.float64) * 2.6 - 1.3
    slow = slow_shift_and_sum(views, slope_map, interpolation, border, weights, batches.even(grid))
    image = per_pixel(views, slope_map, interpolation, border, weights)[0]
    torch.testing.assert_close(image, slow, atol=1e-12, rtol=0)


def test_tilt_shift_is_per_pixel_on_an_affine_map():
    views = torch.rand(2, 3, 3, 1, 9, 10, dtype=torch.float64)
    rows, columns = torch.arange(9).double()[:, None], torch.arange(10).double()
    maps = torch.stack([start + 0.06 * columns - 0.04 * rows for start in (-0.2, 0.5)])
    stack = tilt_shift(views, [-0.2, 0.5], (0.06, -0.04), "cubic", "edge")
    assert stack.shape == (2, 2, 1, 9, 10)
    torch.testing.assert_close(stack, per_pixel(views, maps, "cubic", "edge"), atol=1e-12, rtol=0)
    torch.testing.assert_close(tilt_shift(views, 0.5, [0.06, -0.04], "cubic", "edge")[:, 0], stack[:, 1])


def test_a_slanted_plane_is_sharp_throughout_and_at_no_single_slope():
    start, tilt, size = -0.9, (0.03, 0.02), (48, 56)
    views = slanted_views(start, tilt, (7, 7), size)
    truth = smooth_texture(torch.arange(56).double(), torch.arange(48).double()[:, None])
    flat = shift_and_sum(views, torch.linspace(-0.9, 1.7, 27), "cubic")
    slanted = {name: tilt_shift(views, start, tilt, name)[0] for name in LOCAL}
    assert max(decibels(image, truth) for image in flat) < 27
    assert decibels(slanted["cubic"], truth) > 55
    assert decibels(slanted["linear"], truth) > 37
    # The same tilt the other way round is worse than any good single slope.
    assert decibels(tilt_shift(views, start + 2.6, (-0.03, -0.02), "cubic")[0], truth) < 25


@pytest.mark.parametrize("border", BORDERS)
@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_derivatives_by_views_and_slopes_are_right(interpolation, border):
    views = torch.rand(2, 2, 1, 2, 3, dtype=torch.float64, requires_grad=True)
    # Half a step each way: no position comes near a whole pixel.
    slope_map = (torch.rand(2, 3, dtype=torch.float64) * 0.6 + 0.3).requires_grad_()

    def refocus(views, slope_map):
        return per_pixel(views, slope_map, interpolation, border)

    assert gradcheck(refocus, (views, slope_map), check_forward_ad=True, fast_mode=True)
    tilt = torch.tensor([0.02, 0.03], dtype=torch.float64, requires_grad=True)
    assert gradcheck(lambda t: tilt_shift(views, [0.4, -0.8], t, interpolation, border), tilt)


def nearly_still(*shape: int) -> Tensor:
    """Homographies that move a small picture by a pixel or two and tilt it a little."""
    spread = torch.tensor([[0.1, 0.1, 1.5], [0.1, 0.1, 1.5], [0.01, 0.01, 0.1]], dtype=torch.float64)
    return torch.eye(3) + spread * (2 * torch.rand(*shape, 3, 3, dtype=torch.float64) - 1)


def slow_homography(views: Tensor, matrices: Tensor, interpolation: str, border: str, weights: Tensor) -> Tensor:
    def place(v: int, u: int, x: int, y: int) -> tuple[float, float] | None:
        view_x, view_y, w = (matrices[v, u] @ torch.tensor([x, y, 1], dtype=torch.float64)).tolist()
        return (view_x / w, view_y / w) if w > 0 else None

    return slow_mean(views, place, interpolation, border, weights)


@pytest.mark.parametrize("border", BORDERS)
@pytest.mark.parametrize("interpolation", LOCAL)
def test_homographies_equal_the_slow_reference(interpolation, border):
    views = torch.rand(2, 3, 2, 6, 7, dtype=torch.float64)
    weights = torch.rand(2, 3, dtype=torch.float64)
    matrices = nearly_still(2, 3)
    matrices[0, 1, 2] = torch.tensor([0.4, -0.3, 0.13])  # behind the camera in one corner of the picture
    slow = slow_homography(views, matrices, interpolation, border, weights)
    image = homography(views, matrices, interpolation, border, weights)[0]
    torch.testing.assert_close(image, slow, atol=1e-12, rtol=0)


def test_derivatives_by_views_and_matrices_are_right():
    views = torch.rand(1, 2, 1, 3, 3, dtype=torch.float64, requires_grad=True)
    matrices = nearly_still(2, 1, 2)
    matrices[0, 0, 1, 2] = torch.tensor([0.4, 0.3, -0.5])  # behind the camera in one corner
    matrices.requires_grad_()

    def refocus(views, matrices):
        return homography(views, matrices, "cubic", "edge")

    assert gradcheck(refocus, (views, matrices), check_forward_ad=True)


def test_views_of_weight_0_need_no_matrix():
    views, matrices, weights = torch.rand(2, 2, 1, 6, 6), nearly_still(2, 2), torch.tensor([[1.0, 1.0], [0.0, 1.0]])
    expected = homography(views, matrices, weights=weights)
    matrices[1, 0] = math.nan
    assert torch.equal(homography(views, matrices, weights=weights), expected)


SLOPE_MAPS = torch.zeros(10, 9), torch.zeros(0, 10, 10), torch.full((10, 10), math.nan), torch.full((10, 10), -5.0)
MATRICES = torch.eye(3), torch.eye(3).repeat(3, 2, 1, 1), torch.zeros(0, 3, 3, 3, 3)


@pytest.mark.parametrize(
    ("operator", "surface"), [*((per_pixel, each) for each in SLOPE_MAPS), *((homography, each) for each in MATRICES)]
)
def test_bad_arguments_are_refused(operator, surface):
    with pytest.raises(InputError):
        operator(torch.rand(3, 3, 1, 10, 10), surface)
