"""The disparities of a light field in milliseconds, from the gradients of one row and one column of reduced views.

Where f moves by d pixels a view step, the change from view to view is -d times the gradient g in the picture: least
squares over a window give `d = -sum g L' / sum g^2`, and g^2 weighs the windows. `shift_and_sum_through_cells` and
thinned grids use it: both need a range, not a map, and before anything costly.
Letters: `d` disparity in pixels per view step, `n` views of a line, `h w` rows and columns of reduced pixels.
Source: Adelson, Wang, "Single Lens Stereo with a Plenoptic Camera", 1992.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.refocus import batches, lines

SMALLEST = 32
"""Pixels along the shorter side that reduced views keep."""
REDUCTION = 4
"""Largest factor of the reduction: disparities of some pixels must become a fraction of one."""
WINDOW = 5
"""Side of the window that shares one disparity, in reduced pixels."""
OUTLIERS = 0.04
"""Share of the gradients' energy beyond either end of the range."""


class DisparityRange(NamedTuple):
    """Disparities weighted by the energy of gradients, in pixels per view step."""

    low: float
    """One part in 25 is below."""
    middle: float
    """Mean."""
    high: float
    """One part in 25 is above."""


@torch.no_grad()
def disparity_range(views: Tensor, weights: Tensor | None = None, positions: Tensor | None = None) -> DisparityRange:
    """Estimate the disparities of one light field in a small part of the time that refocusing takes.

    Args:
        views: Floating point, uint8 or uint16, [V, U, C, H, W].
        weights: Weight of each view, those of 0 are not read, [V, U]; None reads all.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Returns:
        The range; all 0 where nothing is known (flat views, a single view, samples that are not finite).
    """
    factor = max(1, min(REDUCTION, min(views.shape[-2:]) // SMALLEST))
    grid, _ = batches.grid_and_size(views)
    cameras = lines.even(grid) if positions is None else lines.checked_positions(positions, grid)
    is_open = torch.ones(grid, dtype=torch.bool) if weights is None else batches.checked_weights(weights, grid) > 0
    # The row and the column with the most open views, of several the middlemost.
    row, column = (_middlemost(counts) for counts in (is_open.sum(1), is_open.sum(0)))
    # A slice copies nothing, a mask copies the views.
    columns, rows = (slice(None) if bool(line.all()) else line for line in (is_open[row], is_open[:, column]))
    moments = _moments(views[row, columns], cameras[row, columns], factor)
    moments = moments + _moments(views[rows, column], cameras[rows, column], factor)
    flat = 1e-12  # energy of the gradients of flat views: rounding of float32
    if not flat <= float(moments[1].sum()) < math.inf:
        return DisparityRange(0.0, 0.0, 0.0)
    local = F.avg_pool2d(moments[None], WINDOW, 1, WINDOW // 2)[0].flatten(1)
    disparity, order = (local[0] / local[1].clamp(min=flat)).sort()
    below = local[1][order].cumsum(0) / local[1].sum()
    low, high = (
        float(disparity[min(int((below < share).sum()), len(order) - 1)]) for share in (OUTLIERS, 1 - OUTLIERS)
    )
    return DisparityRange(factor * low, factor * float(moments[0].sum() / moments[1].sum()), factor * high)


def _middlemost(counts: Tensor) -> int:
    best = (counts == counts.max()).nonzero()[:, 0]
    return int(best[(best - len(counts) // 2).abs().argmin()])


def _moments(line: Tensor, cameras: Tensor, factor: int) -> Tensor:
    """-g L' and g^2 summed over the neighbours of a line of views [n, C, H, W] at (v, u) [n, 2]: [2, h, w]."""
    light = F.avg_pool2d(batches.radiance(line).mean(1)[None], factor)[0]
    change, steps = light[1:] - light[:-1], cameras.diff(dim=0).to(light)
    between, gradient = (light[1:] + light[:-1]) / 2, torch.zeros_like(change)
    for axis in (0, 1):
        # A picture one pixel wide has no gradient, and a line of views along the other axis needs none.
        if light.shape[1 + axis] > 1 and bool(steps[:, axis].any()):
            gradient += steps[:, axis, None, None] * torch.gradient(between, dim=1 + axis)[0]
    return torch.stack([-(gradient * change).sum(0), gradient.square().sum(0)])
