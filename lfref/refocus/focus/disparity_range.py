"""The disparities of a light field at a glance: from the gradients of its middle row and column of views, much reduced.

Where f moves by d pixels a view step, the change from view to view is -d times the change from pixel to pixel.
Letters: `d` disparity in pixels per view step.
Source: Adelson, Wang, "Single Lens Stereo with a Plenoptic Camera", 1992.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.refocus import batches

SMALLEST = 32  # pixels along the shorter side of what is looked at
REDUCTION = 4  # at most: disparities of some pixels must become a fraction of one
WINDOW = 5  # reduced pixels that are taken to be at one disparity
OUTLIERS = 0.04  # of the gradients' energy, at either end
FAINTEST = 1e-12  # energy of gradients below which nothing is to be seen


class DisparityRange(NamedTuple):
    """Disparities weighted by the energy of gradients, in pixels per view step."""

    low: float
    """One part in 25 is below."""
    middle: float
    """Mean."""
    high: float
    """One part in 25 is above."""


@torch.no_grad()
def disparity_range(views: Tensor) -> DisparityRange:
    """Estimate the disparities of one light field in a small part of the time that refocusing takes.

    Args:
        views: Floating point, uint8 or uint16, [V, U, C, H, W].

    Returns:
        The range; all 0 where nothing moves, nothing is to be seen, or samples are not finite.
    """
    factor = max(1, min(REDUCTION, min(views.shape[-2:]) // SMALLEST))
    middle_row, middle_column = views[views.shape[0] // 2], views[:, views.shape[1] // 2]
    moments = sum(_moments(line, axis, factor) for line, axis in ((middle_row, -1), (middle_column, -2)))
    assert isinstance(moments, Tensor)
    if not FAINTEST <= float(moments[1].sum()) < math.inf:
        return DisparityRange(0.0, 0.0, 0.0)
    local = F.avg_pool2d(moments[None], WINDOW, 1, WINDOW // 2)[0].flatten(1)
    disparity, order = (local[0] / local[1].clamp(min=FAINTEST)).sort()
    below = local[1][order].cumsum(0) / local[1].sum()
    low, high = (
        float(disparity[min(int((below < share).sum()), len(order) - 1)]) for share in (OUTLIERS, 1 - OUTLIERS)
    )
    return DisparityRange(factor * low, factor * float(moments[0].sum() / moments[1].sum()), factor * high)


def _moments(line: Tensor, axis: int, factor: int) -> Tensor:
    """Minus the product of both gradients, and the square of the one in the picture, of a line of views, [2, h, w]."""
    light = F.avg_pool2d(batches.radiance(line).mean(1)[None], factor)[0]
    if len(light) < 2 or light.shape[axis] < 2:
        return light.new_zeros(2, *light.shape[1:])
    from_view_to_view = light[1:] - light[:-1]
    between = (light[1:] + light[:-1]) / 2
    (across,) = torch.gradient(between, dim=axis)
    return torch.stack([-(across * from_view_to_view).sum(0), across.square().sum(0)])
