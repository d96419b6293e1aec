"""Shift-and-sum without copies of edges: where all is out of focus, each view stands for its cell of the aperture.

Near the picture of the slow methods, in four times the time of a plain linear sum. In planes beyond the disparities
of the scene all is blurred, and a sum of points would show copies. There each view stands for its whole cell: its box
is as wide as the plane is from the middle disparity, and at most twice as wide as it is from the nearest one. Planes
among the disparities stay sums of points, since cells of one width would blur what is in focus. `Scene.ends` are
these disparities.
Letters: `s` slope in pixels per view step, `N` planes.
"""

import torch
from torch import Tensor

from lfref.functional.devices import is_known, length_of, on_device
from lfref.geometry import Slopes
from lfref.refocus import batches
from lfref.refocus.focus import line_range
from lfref.refocus.focus.line_range import Ends
from lfref.refocus.operator import has_traits
from lfref.refocus.sampling import BORDERS, SPLINE
from lfref.refocus.scene import Scene, scenes_of
from lfref.refocus.shift.shift_and_sum import summed
from lfref.refocus.shift.shifts import shifts_of

FADE = 0.3
"""Pixels per view step over which a sum of points gives way to one of cells: films through the planes stay smooth."""
WIDENED = 2.0
"""Largest width of a cell, in blurs of the nearest light: by trial on path-traced and simulated scenes, 3 loses up to
7 dB where disparities are far apart, 1 loses 1 dB in the mean where views alias."""
LEAST_BLUR = 1.0
"""Least blur of a cell that counts, in pixels: copies that are nearer than one pixel do not show."""


@has_traits("compares")
def shift_and_sum_antialiased(
    views: Tensor,
    slopes: Slopes,
    weights: Tensor | None = None,
    positions: Tensor | None = None,
    scene: Scene | None = None,
) -> Tensor:
    """Refocus by shift-and-sum of splines; where all is out of focus, each view stands for its cell of the aperture.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.
        scene: What `analyze_scene` found in this one light field; None: it is analyzed.

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views, [..., N, C, H, W].
        Derivatives leave out that the range of disparities depends on the views.

    Raises:
        InputError: Views, slopes, weights or positions that cannot be used.

    Example:
        >>> views = torch.rand(7, 7, 3, 48, 64)
        >>> lfref.shift_and_sum_antialiased(views, [-2, 0, 0.5]).shape
        torch.Size([3, 3, 48, 64])
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    planes = batches.checked_slopes(slopes, grid, size, positions)
    aperture = batches.checked_weights(weights, grid)
    scenes = scenes_of(batch, scene, weights, positions)
    return batches.restored(
        [antialiased(field, own, planes, aperture) for field, own in zip(batch, scenes, strict=True)], views
    )


def antialiased(field: Tensor, scene: Scene, planes: Tensor, aperture: Tensor) -> Tensor:
    """A light field [V, U, C, H, W] refocused at planes [N] through the cells that its scene needs, [N, C, H, W]."""
    grid, size = batches.grid_and_size(field)
    shifts = shifts_of(planes, grid, SPLINE, scene.positions)
    widths, reach = cell_widths(on_device(planes, field.device), scene.ends).clamp(max=min(size)), None
    if not is_known(widths):
        beyond = line_range.BEYOND * scene.lines.factor
        if scene.known is not None:
            beyond = max(beyond, -scene.known.low, scene.known.high)
        reach = length_of(((planes.abs().amax(0) + beyond) / 2).ceil().long() + 1)
    return summed(field[None], shifts, widths, aperture, SPLINE, BORDERS["renormalize"], reach)[0]


def cell_widths(planes: Tensor, disparities: Ends) -> Tensor:
    """Width of the box that blurs each plane of these slopes, in pixels, [N]."""
    from_middle = (planes - disparities.middle).abs()
    beyond = torch.maximum(disparities.low - planes, planes - disparities.high).clamp(min=0)
    return torch.minimum(from_middle, WIDENED * beyond) * ((from_middle - LEAST_BLUR) / FADE).clamp(0, 1)
