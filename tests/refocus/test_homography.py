"""Views through homographies: the definition in plain Python, shift-and-sum, and camera rigs rendered exactly."""

import math
from typing import NamedTuple

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.autograd import gradcheck

from lfref.errors import InputError
from lfref.refocus.homography import homography, slope_homographies
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from tests.refocus.slow import slow_mean
from tests.refocus.test_surface import BORDERS, LOCAL, decibels, smooth_texture

SIZE = (40, 48)
INTRINSICS = torch.tensor([[60.0, 0, 23.5], [0, 60, 19.5], [0, 0, 1]], dtype=torch.float64)
SLANTED = [0.5, -0.5, -1.0, -4.0]  # nearer on the right and at the top; 4 units away in the middle


class PinholeCameras(NamedTuple):
    """Pinhole cameras: a world point X is at pixel K (R X + t), homogeneous."""

    intrinsics: Tensor
    """K in pixels, float64, [..., 3, 3]."""
    rotation: Tensor
    """R from world to camera axes, float64, [..., 3, 3]."""
    translation: Tensor
    """t in world units, float64, [..., 3]."""


def plane_homographies(cameras: PinholeCameras, reference: PinholeCameras, planes: Tensor) -> Tensor:
    """Homographies that planes n.X = d (n_x, n_y, n_z, d), [N, 4], induce between a reference picture and each view.

    A pixel p at depth z is X = centre + z to_ray p. On the plane 1/z = q.p is linear in p: the homography.
    """
    to_ray = reference.rotation.mT @ torch.linalg.inv(reference.intrinsics)
    centre = -reference.rotation.mT @ reference.translation
    normals, distances = planes.double()[:, :3], planes.double()[:, 3]
    inverse_depth = normals @ to_ray / (distances - normals @ centre)[:, None]
    inverse_depth = inverse_depth.reshape(-1, *(1 for _ in cameras.intrinsics.shape[:-2]), 1, 3)
    turned, offset = cameras.rotation @ to_ray, cameras.rotation @ centre + cameras.translation
    return cameras.intrinsics @ (turned + offset[..., None] * inverse_depth)


def nearly_still(*shape: int) -> Tensor:
    """Homographies that move a small picture by a pixel or two and tilt it a little."""
    spread = torch.tensor([[0.1, 0.1, 1.5], [0.1, 0.1, 1.5], [0.01, 0.01, 0.1]], dtype=torch.float64)
    return torch.eye(3) + spread * (2 * torch.rand(*shape, 3, 3, dtype=torch.float64) - 1)


def rotation(angles: Tensor) -> Tensor:
    """Rotations by a vector of small angles each, [..., 3] -> [..., 3, 3]."""
    a, b, c = angles.unbind(-1)
    zero = torch.zeros_like(a)
    cross = torch.stack([zero, -c, b, c, zero, -a, -b, a, zero], dim=-1).unflatten(-1, (3, 3))
    return torch.linalg.matrix_exp(cross)


def single(intrinsics: Tensor = INTRINSICS) -> PinholeCameras:
    """A camera at the origin that looks along z."""
    return PinholeCameras(intrinsics, torch.eye(3).double(), torch.zeros(3).double())


def rig(n_rows: int, n_columns: int, disorder: float) -> PinholeCameras:
    """PinholeCameras 0.25 units apart; with disorder they also move forwards, turn, and differ in focal length."""
    v, u = torch.meshgrid(torch.arange(n_rows).double(), torch.arange(n_columns).double(), indexing="ij")
    centre = 0.25 * torch.stack([u - u.mean(), v - v.mean(), 0.4 * disorder * torch.randn_like(u)], dim=-1)
    turned = rotation(0.04 * disorder * torch.randn(n_rows, n_columns, 3, dtype=torch.float64))
    intrinsics = INTRINSICS.repeat(n_rows, n_columns, 1, 1)
    intrinsics[..., :2, :2] *= 1 + 0.02 * disorder * torch.randn(n_rows, n_columns, 1, 1)
    return PinholeCameras(intrinsics, turned, -(turned @ centre[..., None])[..., 0])


def rendered(camera: tuple[Tensor, Tensor, Tensor], plane: list[float]) -> Tensor:
    """What one camera (K, R, t) sees of the textured plane, [1, H, W], by meeting the ray of each pixel with it."""
    intrinsics, turned, translation = camera
    x, y = torch.arange(SIZE[1]).double().expand(SIZE), torch.arange(SIZE[0]).double()[:, None].expand(SIZE)
    rays = torch.stack([x, y, torch.ones_like(x)], dim=-1) @ (turned.mT @ torch.linalg.inv(intrinsics)).mT
    start, normal = -turned.mT @ translation, torch.tensor(plane[:3], dtype=torch.float64)
    points = start + rays * ((plane[3] - start @ normal) / (rays @ normal))[..., None]
    return smooth_texture(12 * points[..., 0], 12 * points[..., 1])[None]


def rendered_views(cameras: PinholeCameras, plane: list[float]) -> Tensor:
    parts = (cameras.intrinsics, cameras.rotation, cameras.translation)
    images = [rendered(camera, plane) for camera in zip(*(part.flatten(0, 1) for part in parts), strict=True)]
    return torch.stack(images).unflatten(0, cameras.intrinsics.shape[:2])


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


def test_coplanar_cameras_that_face_the_plane_shift_by_focal_length_times_baseline_over_depth():
    depths = torch.tensor([3.0, 5.0, 40.0])
    planes = torch.tensor([[0, 0, 1, depth] for depth in depths])
    matrices = plane_homographies(rig(3, 4, disorder=0), single(), planes)
    # A camera further to the right sees the scene further to the left: the slope is below 0.
    expected = slope_homographies(-60 * 0.25 / depths.double(), (3, 4))
    torch.testing.assert_close(matrices, expected, atol=1e-12, rtol=0)


@given(where=st.tuples(*[st.floats(0, 39)] * 2), plane=st.tuples(*[st.floats(-0.5, 0.5)] * 2, st.floats(2, 9)))
@settings(max_examples=25, deadline=None)
def test_a_homography_follows_points_of_its_plane(where, plane):
    cameras, normal = rig(2, 2, disorder=1), torch.tensor([*plane[:2], 1], dtype=torch.float64)
    ray = torch.linalg.inv(INTRINSICS) @ torch.tensor([*where, 1], dtype=torch.float64)
    point = ray * plane[2] / (ray @ normal)
    planes = torch.tensor([[*plane[:2], 1, plane[2]]], dtype=torch.float64)
    matrices = plane_homographies(cameras, single(), planes)[0]
    mapped = matrices @ torch.tensor([*where, 1], dtype=torch.float64)
    expected = (cameras.intrinsics @ (cameras.rotation @ point + cameras.translation)[..., None])[..., 0]
    torch.testing.assert_close(mapped / mapped[..., 2:], expected / expected[..., 2:], atol=1e-9, rtol=0)
    # What w is beyond its sign: depth in the view over depth in the reference.
    torch.testing.assert_close(mapped[..., 2], expected[..., 2] / point[2], atol=1e-12, rtol=0)


def test_a_disordered_rig_is_sharp_on_a_slanted_plane_and_blurred_beside_it():
    cameras = rig(4, 5, disorder=1)
    views, truth = rendered_views(cameras, SLANTED), rendered_views(rig(1, 1, disorder=0), SLANTED)[0, 0]
    beside = [[0.5, -0.5, -1.0, -8.0], [0, 0, 1, 4.0]]
    sharp, further, facing = homography(
        views, plane_homographies(cameras, single(), torch.tensor([SLANTED, *beside])), "cubic"
    )
    assert decibels(sharp, truth) > 55
    assert decibels(further, truth) < 20
    assert decibels(facing, truth) < 38
    assert max(decibels(image, truth) for image in shift_and_sum(views, torch.linspace(-5, 0, 26), "cubic")) < 22


def test_the_reference_need_not_be_one_of_the_cameras():
    cameras = rig(3, 3, disorder=1)
    narrow = INTRINSICS * torch.tensor([[1.2], [1.2], [1]])
    elsewhere = PinholeCameras(
        narrow, rotation(torch.tensor([0.02, -0.03, 0.1]).double()), torch.tensor([0.05, 0.02, 0.3]).double()
    )
    truth = rendered((elsewhere.intrinsics, elsewhere.rotation, elsewhere.translation), SLANTED)
    matrices = plane_homographies(cameras, elsewhere, torch.tensor([SLANTED]))
    assert decibels(homography(rendered_views(cameras, SLANTED), matrices, "cubic")[0], truth) > 50


@pytest.mark.parametrize("border", BORDERS)
def test_points_behind_a_camera_have_no_sample_under_any_border(border):
    views = torch.tensor([1.0, 3.0]).reshape(1, 2, 1, 1, 1).expand(1, 2, 1, 4, 6)
    matrices = torch.eye(3).repeat(1, 2, 1, 1)
    # w = 2 - x: in front of the second camera left of column 2 only, and on it throughout, near (1, 1).
    matrices[0, 1] = torch.tensor([[-1, 1e-3, 2], [-1, 0, 2 + 1e-3], [-1, 0, 2]])
    image = homography(views, matrices, border=border)[0, 0]
    assert image[1].tolist() == [2, 2, 1, 1, 1, 1]


@pytest.mark.parametrize("interpolation", LOCAL)
def test_only_the_ratio_of_the_coordinates_counts(interpolation):
    views, matrices = torch.rand(2, 2, 1, 6, 7, dtype=torch.float64), nearly_still(2, 2)
    scaled = matrices * torch.tensor([[0.25, 4], [2, 1024]])[..., None, None]
    assert torch.equal(homography(views, scaled, interpolation), homography(views, matrices, interpolation))


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


def grid_of(matrix: list[list[float]]) -> Tensor:
    return torch.tensor(matrix).repeat(3, 3, 1, 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"matrices": torch.eye(3)}, r"matrices must be \[3, 3, 3, 3\] or \[N, 3, 3, 3, 3\]; got shape \[3, 3\]"),
        ({"matrices": torch.eye(3).repeat(3, 2, 1, 1)}, "matrices must be"),
        ({"matrices": torch.zeros(0, 3, 3, 3, 3)}, "matrices must be"),
        ({"matrices": grid_of([[1, 0, math.nan], [0, 1, 0], [0, 0, 1]])}, "matrices must be finite"),
        ({"matrices": grid_of([[1, 0, 0], [2, 0, 0], [0, 0, 1]])}, "matrices must be invertible"),
        ({"matrices": torch.zeros(3, 3, 3, 3)}, "matrices must be invertible"),
        ({"matrices": -grid_of([[1, 0, 0], [0, 1, 0], [0, 0, 1]]), "border": "edge"}, "sign -1"),
        ({"matrices": grid_of([[1, 0, 99], [0, 1, 0], [0, 0, 1]])}, "at least one view must have a sample"),
    ],
)
def test_bad_arguments_are_refused(change, message):
    arguments = {"views": torch.rand(3, 3, 1, 10, 10), "matrices": torch.eye(3).repeat(3, 3, 1, 1)} | change
    with pytest.raises(InputError, match=message):
        homography(**arguments)


@pytest.mark.parametrize("slopes", [[], [math.inf]])
def test_slopes_that_are_none_are_refused(slopes):
    with pytest.raises(InputError, match="slopes must be finite and at least one"):
        slope_homographies(slopes, (3, 3))
