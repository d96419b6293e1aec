"""Do rows and columns of views tell the same disparities? Where one axis is reversed they tell opposite ones.

Reversing both axes only swaps the sign of the slope; with one reversed nothing but slope 0 comes into focus.
"""

import torch

from lfref.refocus.focus.glance import first_look
from lfref.refocus.focus.reduced_views import ReducedViews

SURE = 0.5  # confidence, along both axes
LEAST_SHARE = 0.02  # of the picture that must be sure
LEAST_MOTION = 0.03  # of that part, in coarse pixels per view step: below, signs mean nothing
AGREE = 0.5  # correlation: simulated scenes of all kinds have .74 to 1, with one axis reversed -.74 to -1


def seems_reversed(seen: ReducedViews) -> bool:
    """Whether one axis of the views is reversed: which one cannot be told, nor matters.

    Args:
        seen: Reduced views; of a single row or column nothing is known.

    Example:
        >>> from lfref.refocus.focus.reduced_views import reduced
        >>> seems_reversed(reduced(torch.rand(1, 5, 3, 64, 64)))
        False
    """
    return correlation(seen) < -AGREE


@torch.no_grad()
def correlation(seen: ReducedViews) -> float:
    """Of the disparities that the column of views tells with those of the row, -1 to 1; 0 where nothing is known.

    Args:
        seen: Reduced views.
    """
    lines = [seen.along(axis) for axis in (0, 1)]
    if min(len(line.places) for line in lines) < 2:
        return 0.0
    column, row = (first_look(line) for line in lines)
    sure = (column.confidence > SURE) & (row.confidence > SURE)
    if float(sure.float().mean()) < LEAST_SHARE:
        return 0.0
    both = torch.stack([column.disparity[sure], row.disparity[sure]])
    motion = both.square().mean(1).sqrt()
    if float(motion.min()) < LEAST_MOTION * row.factor:
        return 0.0
    return float((both[0] * both[1]).mean() / motion.prod())
