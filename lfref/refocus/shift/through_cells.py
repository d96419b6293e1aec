"""Shift-and-sum through cells of the aperture, as good a picture as linear interpolation's twofold time allows.

Planes beyond the disparities of the scene, where all is blurred, look through whole cells, blurred by their distance
from the middle disparity: a sum of points would show copies. Planes among them stay sums of points, since cells of one
width would blur what is in focus. Interpolation is cubic.
"""

import torch
from torch import Tensor

from lfref.geometry import Slopes
from lfref.refocus import batches, lines
from lfref.refocus.disparity.disparity_range import DisparityRange, disparity_range
from lfref.refocus.shift import shift_and_sum, shift_torch

FADE = 0.3
"""Pixels per view step over which a sum of points gives way to one of cells."""
LEAST = 1.0
"""Blur of a cell, in pixels, from which on copies show: cells that blur less are left as points."""


def shift_and_sum_through_cells(
    views: Tensor, slopes: Slopes, weights: Tensor | None = None, positions: Tensor | None = None
) -> Tensor:
    """Refocus light fields by shift-and-sum, each view standing for its cell of the aperture where all is out of focus.

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
    stacks = [_stack(field, planes, weights, positions) for field in batch]
    # One alone is not copied: that would take a tenth of all the time.
    return batches.restored(torch.cat(stacks) if len(stacks) > 1 else stacks[0], views)


def widths(planes: Tensor, seen: DisparityRange) -> Tensor:
    """Width of the box that each plane is blurred by, in pixels, [N].

    Args:
        planes: Slopes, [N].
        seen: What disparities the scene has.
    """
    from_middle = (planes - seen.middle).abs()
    beyond = torch.maximum(seen.low - planes, planes - seen.high)
    return from_middle * (beyond / FADE).clamp(0, 1) * ((from_middle - LEAST) / FADE).clamp(0, 1)


def _stack(field: Tensor, planes: Tensor, weights: Tensor | None, positions: Tensor | None) -> Tensor:
    """One light field, [V, U, C, H, W], as [1, N, C, H, W]."""
    grid, size = batches.grid_and_size(field)
    boxes = widths(planes, disparity_range(field.detach(), weights, positions)).clamp(max=min(size)).tolist()
    planned = shift_torch.plan(planes, grid, size, "cubic", weights=weights, widths=boxes, positions=positions)
    return shift_and_sum.planned_stack(field[None], planned)
