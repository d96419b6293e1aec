"""Shift-and-sum through cells of the aperture, as good a picture as linear interpolation's twofold time allows.

Planes beyond the disparities of the scene, where all is blurred, look through whole cells, blurred by their distance
from the middle disparity: a sum of points would show copies. Planes among them stay sums of points, since cells of one
width would blur what is in focus. Interpolation is cubic.
"""

import torch
from torch import Tensor

from lfref import geometry
from lfref.geometry import Slopes
from lfref.refocus import batches
from lfref.refocus.focus.disparity_range import disparity_range
from lfref.refocus.shift import shift_and_sum, task

CLOSE = 0.1
"""Pixels per view step beyond the range of disparities that still count as among them."""


def shift_and_sum_through_cells(views: Tensor, slopes: Slopes, weights: Tensor | None = None) -> Tensor:
    """Refocus light fields by shift-and-sum, each view standing for its cell of the aperture where all is out of focus.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views, [..., N, C, H, W].
        Derivatives leave out that the range of disparities depends on the views.

    Raises:
        InputError: Views, slopes or weights that cannot be used.

    Example:
        >>> views = torch.rand(7, 7, 3, 48, 64)
        >>> lfref.shift_and_sum_through_cells(views, [-2, 0, 0.5]).shape
        torch.Size([3, 3, 48, 64])
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    planes = geometry.checked_slopes(slopes, grid, size)
    stacks = [_stack(field, planes, grid, size, weights) for field in batch]
    return batches.restored(torch.cat(stacks), views)


def _stack(
    field: Tensor, planes: Tensor, grid: tuple[int, int], size: tuple[int, int], weights: Tensor | None
) -> Tensor:
    """One light field, [V, U, C, H, W], as [1, N, C, H, W]."""
    seen = disparity_range(field.detach())
    is_among = (planes >= seen.low - CLOSE) & (planes <= seen.high + CLOSE)
    widths = torch.where(is_among, 0.0, (planes - seen.middle).abs()).clamp(max=min(size)).tolist()
    planned = task.plan(planes, grid, size, "cubic", weights=weights, widths=widths)
    return shift_and_sum.planned_stack(field[None], planned)
