"""Views through homographies: the definition in plain Python, shift-and-sum, and camera rigs rendered exactly."""

import math

import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck

from lfref.errors import InputError
from lfref.refocus.homography import homography, slope_homographies
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from tests.refocus.slow import slow_mean
from tests.refocus.test_surface import BORDERS, LOCAL


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
def test_equals_the_slow_reference(interpolation, border):
    views = torch.rand(2, 3, 2, 6, 7, dtype=torch.float64)
    weights = torch.rand(2, 3, dtype=torch.float64)
    matrices = nearly_still(2, 3)
    matrices[0, 1, 2] = torch.tensor([0.4, -0.3, 0.13])  # behind the camera in one corner of the picture
    slow = slow_homography(views, matrices, interpolation, border, weights)
    image = homography(views, matrices, interpolation, border, weights)[0]
    torch.testing.assert_close(image, slow, atol=1e-12, rtol=0)


def test_shifts_are_shift_and_sum():
    views, slopes = torch.rand(3, 4, 2, 11, 12, dtype=torch.float64), [-1.4, -1.0, 0.0, 0.37, 2.0]
    stack = homography(views, slope_homographies(slopes, (3, 4)))
    torch.testing.assert_close(stack, shift_and_sum(views, slopes), atol=1e-12, rtol=0)


@pytest.mark.parametrize("border", BORDERS)
def test_points_behind_a_camera_have_no_sample_under_any_border(border):
    views = torch.tensor([1.0, 3.0]).reshape(1, 2, 1, 1, 1).expand(1, 2, 1, 4, 6)
    matrices = torch.eye(3).repeat(1, 2, 1, 1)
    # w = 2 - x: in front of the second camera left of column 2 only, and on it throughout, near (1, 1).
    matrices[0, 1] = torch.tensor([[-1, 1e-3, 2], [-1, 0, 2 + 1e-3], [-1, 0, 2]])
    image = homography(views, matrices, border=border)[0, 0]
    assert image[1].tolist() == [2, 2, 1, 1, 1, 1]


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


@pytest.mark.parametrize("matrices", [torch.eye(3), torch.eye(3).repeat(3, 2, 1, 1), torch.zeros(0, 3, 3, 3, 3)])
def test_matrices_of_another_shape_are_refused(matrices):
    with pytest.raises(InputError):
        homography(torch.rand(3, 3, 1, 10, 10), matrices)
