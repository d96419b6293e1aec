"""Shift-and-sum through cells of the aperture: nearly the picture of the slow methods, at twice linear's time.

In planes beyond the disparities of the scene all is blurred, and a sum of points would show copies. There each view
stands for its whole cell: the plane is blurred by a box as wide as its distance from the middle disparity. Planes
within the disparities stay sums of points, since cells of one width would blur what is in focus. Interpolation is
cubic. The module stands apart from `shift_and_sum`, which it uses, because it measures the views (`disparity_range`)
before it sums them.
"""

import torch
from torch import Tensor

from lfref.geometry import Slopes
from lfref.refocus import batches, lines
from lfref.refocus.disparity.disparity_range import DisparityRange, disparity_range
from lfref.refocus.shift import shift_and_sum, shift_plan

FADE = 0.3
"""Pixels per view step over which a sum of points gives way to one of cells: films through the planes stay smooth."""
LEAST = 1.0
"""Least blur of a cell that counts, in pixels: copies that are nearer than one pixel do not show."""


def shift_and_sum_through_cells(
    views: Tensor, slopes: Slopes, weights: Tensor | None = None, positions: Tensor | None = None
) -> Tensor:
    """Refocus by shift-and-sum; where all is out of focus, each view stands for its cell of the aperture.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views, [..., N, C, H, W].
        Derivatives leave out that the range of disparities depends on the views.

    Raises:
        InputError: Views, slopes, weights or positions that cannot be used.

    Example:
        >>> views = torch.rand(7, 7, 3, 48, 64)
        >>> lfref.shift_and_sum_through_cells(views, [-2, 0, 0.5]).shape
        torch.Size([3, 3, 48, 64])
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    planes = lines.checked_slopes(slopes, grid, size, positions)
    stacks = []
    for field in batch:
        boxes = widths(planes, disparity_range(field.detach(), weights, positions)).clamp(max=min(size)).tolist()
        plan = shift_plan.plan(planes, grid, size, "cubic", weights=weights, widths=boxes, positions=positions)
        stacks.append(shift_and_sum.planned_stack(field[None], plan))
    # A single one is not copied: that would take a tenth of all the time.
    return batches.restored(torch.cat(stacks) if len(stacks) > 1 else stacks[0], views)


def widths(planes: Tensor, disparities: DisparityRange) -> Tensor:
    """Width of the box that blurs each plane of these slopes, in pixels, [N]."""
    from_middle = (planes - disparities.middle).abs()
    beyond = torch.maximum(disparities.low - planes, planes - disparities.high)
    return from_middle * (beyond / FADE).clamp(0, 1) * ((from_middle - LEAST) / FADE).clamp(0, 1)
