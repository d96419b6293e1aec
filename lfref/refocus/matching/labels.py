"""Disparities in steps: the slope of each pixel among those tried, and how clearly it is the best.

Letters: `s` slope in pixels per view step, `N` slopes tried.
"""

import math

import torch
from torch import Tensor

from lfref.refocus import windows
from lfref.refocus.matching import agreement, paths
from lfref.refocus.matching.grey import GreyViews

STEP = 0.1
"""Between slopes, in pixels per view step: `refining` finds what lies between them."""
FLOOR = 1e-3
"""Share of disagreeing views that is as good as none."""


def slopes_between(first: float, last: float) -> Tensor:
    """Slopes to try, at most a step apart, float64, [N]."""
    return torch.linspace(first, last, 1 + math.ceil((last - first) / STEP - 1e-9), dtype=torch.float64)


def best_slopes(views: GreyViews, slopes: Tensor, noise: float, radius: float) -> tuple[Tensor, Tensor]:
    """The slope of each pixel and its confidence, [H, W] each.

    Args:
        views: The views.
        slopes: Slopes tried, evenly spaced, in pixels per view step, [N].
        noise: Standard deviation of a view.
        radius: Standard deviation of the window in which views are compared, in pixels.
    """
    spread = agreement.spread(views, noise).numpy()
    shares = windows.smoothed(agreement.disagreements(views, slopes, spread), radius)
    costs = paths.along_paths(shares, views.central)
    best = costs.argmin(0, keepdim=True)
    step = float(slopes[1] - slopes[0]) if len(slopes) > 1 else 0.0
    disparity = float(slopes[0]) + step * (best + _least(costs, best))[0]
    least, mean = shares.gather(0, best)[0], shares.mean(0)
    return disparity, ((mean - least) / (mean + FLOOR)).clamp(min=0)


def _least(costs: Tensor, best: Tensor) -> Tensor:
    """Where a parabola through the least cost and its neighbours has its least, in slopes from it, [1, H, W]."""
    last = len(costs) - 1
    before, here, after = (costs.gather(0, (best + step).clamp(0, last)) for step in (-1, 0, 1))
    rise_before, rise_after = before - here, after - here
    offset = (rise_before - rise_after) / (2 * (rise_before + rise_after)).clamp(min=torch.finfo(costs.dtype).tiny)
    return torch.where((best > 0) & (best < last), offset, 0.0)
