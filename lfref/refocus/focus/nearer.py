"""Which disparities are nearer: what hides is in front of what is hidden.

Cameras that stand as they are counted see near points move against their own way, so that smaller disparities are
nearer; where both axes of views are counted the other way, larger ones are. Next to the edge of a surface in front, one
half of the aperture sees what the other does not: views of that half agree, at the disparity of what is behind.
Whether disparities around are larger or smaller than that one is counted over the picture.
Only the middle row and the middle column of views are looked at.
Letters: `s` slope in pixels per view step, `N` slopes tried, `n` views of a line.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.functional.neighbours import box_max
from lfref.refocus import batches, windows
from lfref.refocus.shift.shift_and_sum import shift_and_sum

STEP = 0.1  # between the slopes tried, in pixels per view step
RADIUS = 1.0  # standard deviation of the window in which views are compared, in pixels
AROUND = 3  # pixels: so near to a pixel the surface that hides it must show, and its own too
UNLIKE = 6.0  # times as much the hidden half must disagree
SURE = 0.8  # confidence of the half that sees
FAINTEST = 1e-4  # variance over all slopes below which there is no texture to tell anything by
FLOOR = 1e-6  # variance of views that agree as well as 8 bits can say
NOTABLE, OWN = 0.35, 0.1  # of the range of disparities: least step that counts, and what still is the same surface
LEAST_PIXELS, LEAST_SCORE = 30, 0.5
OUTLIERS = 0.01  # of the disparities that are sure, at either end
MARGIN = 8  # pixels at the borders, where views end


class _Half(NamedTuple):
    """What the views on one side of the centre of a line say."""

    cost: Tensor
    """Their variance at each slope, [N, H, W]."""
    least: Tensor
    """The least of it, [1, H, W]."""
    best: Tensor
    """Which slope has it, [1, H, W]."""


@torch.no_grad()
def nearer_sign(views: Tensor, disparity: Tensor, confidence: Tensor) -> int:
    """Tell by what hides what whether larger or smaller disparities are nearer.

    Args:
        views: Floating point, uint8 or uint16, [V, U, C, H, W].
        disparity: Of each pixel of the central view, in pixels per view step, [H, W].
        confidence: Of the disparity, [0, 1], [H, W].

    Returns:
        1 if larger disparities are nearer, -1 if smaller ones are, 0 where nothing clearly hides anything.
    """
    sure = disparity[confidence > SURE / 2]
    if sure.numel() < LEAST_PIXELS:
        return 0
    ordered = sure.double().sort().values
    first, last = (float(ordered[round(share * (len(ordered) - 1))]) for share in (OUTLIERS, 1 - OUTLIERS))
    light = batches.radiance(views).mean(2, keepdim=True)
    middle_row, middle_column = light[None, light.shape[0] // 2], light[:, None, light.shape[1] // 2]
    steps = torch.cat([_steps(line, disparity, first - STEP, last + STEP) for line in (middle_row, middle_column)])
    if len(steps) < LEAST_PIXELS:
        return 0
    score = float(steps.sum() / steps.abs().sum())
    return int(math.copysign(1, score)) if abs(score) > LEAST_SCORE else 0


def _steps(line: Tensor, disparity: Tensor, first: float, last: float) -> Tensor:
    """From what is hidden in one half of a line of views to what is around it: notable steps of disparity, [P]."""
    if max(line.shape[:2]) < 3 or min(line.shape[-2:]) <= 2 * MARGIN:
        return line.new_zeros(0)
    slopes = torch.linspace(first, last, 1 + math.ceil((last - first) / STEP), dtype=torch.float64)
    one, other = (_half(line, slopes, side) for side in (1, -1))
    is_one = one.least < other.least
    hidden = torch.where(is_one, other.cost.gather(0, one.best), one.cost.gather(0, other.best))[0]
    seen = torch.where(is_one, one.least, other.least)[0]
    mean = torch.where(is_one[0], one.cost.mean(0), other.cost.mean(0))
    rise, fall = _around(disparity.to(line), slopes.to(line)[torch.where(is_one, one.best, other.best)[0]])
    step = rise.clamp(min=0) - fall.clamp(min=0)
    is_hidden = (hidden > UNLIKE * seen) & (seen < (1 - SURE) * mean) & (mean > FAINTEST)
    is_hidden &= step.abs() > NOTABLE * (last - first)
    is_hidden &= torch.minimum(rise.abs(), fall.abs()) < max(STEP, OWN * (last - first))
    inside = slice(MARGIN, -MARGIN)
    return step[inside, inside][is_hidden[inside, inside]]


def _half(line: Tensor, slopes: Tensor, side: int) -> _Half:
    """The views of a line [1, n, 1, H, W] or [n, 1, 1, H, W] on one side of its centre."""
    places = torch.arange(max(line.shape[:2]), dtype=torch.float64) - (max(line.shape[:2]) - 1) / 2
    weights = (side * places >= 0).double().reshape(line.shape[:2])
    light = torch.cat([line, line.square()], 2)
    mean, square = shift_and_sum(light, slopes, "cubic", weights=weights).unbind(1)
    cost = windows.smoothed((square - mean.square()).clamp(min=0), RADIUS) + FLOOR
    return _Half(cost, *cost.min(0, keepdim=True))


def _around(disparity: Tensor, here: Tensor) -> tuple[Tensor, Tensor]:
    """How far disparities around a pixel reach above and below one of its own, [H, W] each."""
    most, least = (sign * box_max(sign * disparity, 2 * AROUND + 1) for sign in (1, -1))
    return most - here, here - least
