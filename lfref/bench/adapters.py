"""Operators that ask for something else than slopes, as methods: views and slopes in, stack out."""

from torch import Tensor

from lfref.refocus.anywhere.homography import homography, slope_homographies
from lfref.refocus.focus.all_in_focus import all_in_focus
from lfref.refocus.fourier.focal_stack_transform import focal_stack_transform
from lfref.refocus.shift.shift_and_sum import shift_and_sum


def even_stack(views: Tensor, slopes: Tensor) -> Tensor:
    """The focal stack transform with as many planes between the same extremes.

    Args:
        views: Light fields, [..., V, U, C, H, W].
        slopes: In pixels per view step, in any order, [N].
    """
    return focal_stack_transform(views, len(slopes), float(slopes.min()), float(slopes.max()))


def coplanar_homography(views: Tensor, slopes: Tensor) -> Tensor:
    """Homographies of cameras in one plane, which shift-and-sum needs no matrices for.

    Args:
        views: Light fields, [..., V, U, C, H, W].
        slopes: In pixels per view step, [N].
    """
    return homography(views, slope_homographies(slopes, (views.shape[-5], views.shape[-4])))


def focus(views: Tensor, slopes: Tensor) -> Tensor:
    """The all-in-focus picture of a linear shift-and-sum, as a stack of one.

    Args:
        views: Light fields, [..., V, U, C, H, W].
        slopes: In pixels per view step, [N].
    """
    return all_in_focus(shift_and_sum(views, slopes)).image.unsqueeze(-4)
