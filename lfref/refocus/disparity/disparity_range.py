"""The disparities of a light field at a glance: from the gradients of a row and a column of views, much reduced.

Where f moves by d pixels a view step, the change from view to view is -d times the change from pixel to pixel.
Letters: `d` disparity in pixels per view step.
Source: Adelson, Wang, "Single Lens Stereo with a Plenoptic Camera", 1992.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.refocus import batches, lines

SMALLEST = 32  # pixels along the shorter side of what is looked at
REDUCTION = 4  # at most: disparities of some pixels must become a fraction of one
WINDOW = 5  # reduced pixels that are taken to be at one disparity
OUTLIERS = 0.04  # of the gradients' energy, at either end
FAINTEST = 1e-12  # energy of gradients below which nothing is to be seen

Index = int | slice | Tensor
"""Of rows or columns of views."""


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
        weights: Synthetic aperture, [V, U]: views of weight 0 are not looked at; None looks at all.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Returns:
        The range; all 0 where nothing moves, nothing is to be seen, or samples are not finite.
    """
    factor = max(1, min(REDUCTION, min(views.shape[-2:]) // SMALLEST))
    grid, _ = batches.grid_and_size(views)
    stand = lines.even(grid) if positions is None else lines.checked_positions(positions, grid)
    moments = torch.stack([_moments(views[line], stand[line], factor) for line in _looked_at(grid, weights)]).sum(0)
    if not FAINTEST <= float(moments[1].sum()) < math.inf:
        return DisparityRange(0.0, 0.0, 0.0)
    local = F.avg_pool2d(moments[None], WINDOW, 1, WINDOW // 2)[0].flatten(1)
    disparity, order = (local[0] / local[1].clamp(min=FAINTEST)).sort()
    below = local[1][order].cumsum(0) / local[1].sum()
    low, high = (
        float(disparity[min(int((below < share).sum()), len(order) - 1)]) for share in (OUTLIERS, 1 - OUTLIERS)
    )
    return DisparityRange(factor * low, factor * float(moments[0].sum() / moments[1].sum()), factor * high)


def _looked_at(grid: tuple[int, int], weights: Tensor | None) -> list[tuple[Index, Index]]:
    """Indices of the views of the middlemost row, and column, that have the most to look at."""
    is_open = torch.ones(grid, dtype=torch.bool) if weights is None else batches.checked_weights(weights, grid) > 0
    row, column = (_middlemost(counts) for counts in (is_open.sum(1), is_open.sum(0)))
    return [(row, _where(is_open[row])), (_where(is_open[:, column]), column)]


def _where(is_open: Tensor) -> Index:
    """Index of the open views of a line; of all a slice, which copies nothing."""
    return slice(None) if bool(is_open.all()) else is_open.nonzero()[:, 0]


def _middlemost(counts: Tensor) -> int:
    """Number of the largest count, of several the one nearest to the middle."""
    best = (counts == counts.max()).nonzero()[:, 0]
    return int(best[(best - len(counts) // 2).abs().argmin()])


def _moments(line: Tensor, stand: Tensor, factor: int) -> Tensor:
    """Minus the product of both gradients, and the square of the one in the picture, of a line of views, [2, h, w].

    Args:
        line: Views, [n, C, H, W].
        stand: (v, u) of their cameras, [n, 2].
        factor: By which they are reduced.
    """
    light = F.avg_pool2d(batches.radiance(line).mean(1)[None], factor)[0]
    from_view_to_view, steps = light[1:] - light[:-1], stand.diff(dim=0).to(light)
    between, across = (light[1:] + light[:-1]) / 2, torch.zeros_like(from_view_to_view)
    for axis in (0, 1):
        # A picture one pixel wide has no gradient, and a line of views along the other axis needs none.
        if light.shape[1 + axis] > 1 and bool(steps[:, axis].any()):
            across += steps[:, axis, None, None] * torch.gradient(between, dim=1 + axis)[0]
    return torch.stack([-(across * from_view_to_view).sum(0), across.square().sum(0)])
