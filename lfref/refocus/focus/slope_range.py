"""The slopes between which a scene lies: those of what is seen well, a few strays at either end left out."""

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.refocus.focus.glance import Glance

SURE = 0.5  # confidence
TOGETHER, NEIGHBOURS = 0.1, 6  # a surface: so many of the 8 neighbours differ by less than that, in reduced pixels
STRAYS = 0.01  # of what is seen, left out at either end
MARGIN = 0.03  # of the range, added at either end: windows see less of what is small
FEWEST = 50  # reduced pixels that must be seen


@torch.no_grad()
def slope_range(seen: Glance) -> tuple[float, float] | None:
    """The range of disparities of a scene.

    Args:
        seen: First look at it.

    Returns:
        Lower and upper end, in pixels per view step; None where too little is seen well.

    Example:
        >>> from lfref.refocus.focus.glance import glance
        >>> from lfref.refocus.focus.reduced_views import reduced
        >>> slope_range(glance(reduced(torch.full((5, 5, 3, 64, 64), 0.5)))) is None
        True
    """
    sure = well_seen(seen)
    if int(sure.sum()) < min(FEWEST, sure.numel() / 4):
        return None
    low, high = seen.disparity[sure].quantile(torch.tensor([STRAYS, 1 - STRAYS])).tolist()
    margin = MARGIN * (high - low)
    return low - margin, high + margin


def well_seen(seen: Glance) -> Tensor:
    """Which reduced pixels are sure and lie on a surface, bool, [h, w].

    Args:
        seen: First look.
    """
    padded = F.pad(seen.disparity[None, None], (1, 1, 1, 1), mode="replicate")
    around = F.unfold(padded, 3).reshape(9, *seen.disparity.shape)
    together = ((around - seen.disparity).abs() < TOGETHER * seen.factor).sum(0) > NEIGHBOURS
    return (seen.confidence > SURE) & together
