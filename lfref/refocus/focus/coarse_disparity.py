"""Disparity of large views by a look at half their size: a quarter of the time, enough to know where edges are.

Letters: `d` disparity in pixels per view step.
"""

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.refocus.focus.disparity import disparity_map

LARGE = 256
"""Pixels along the shorter side from which there is time to save, and halves of views still show where edges are."""


@torch.no_grad()
def coarse_disparity(field: Tensor, first: float | None = None, last: float | None = None) -> Tensor:
    """Disparity of each pixel of the central view; of large views alike in squares of two by two.

    Args:
        field: Radiance, [V, U, C, H, W], floating point.
        first: Least disparity to look for, in pixels per view step; None looks for it.
        last: Largest disparity to look for, likewise.

    Returns:
        In pixels per view step, [H, W].

    Raises:
        InputError: Views or a range that cannot be used.
    """
    height, width = field.shape[-2:]
    if min(height, width) < LARGE:
        return disparity_map(field, first, last).disparity
    # Colours are averaged first: the map would do so, of four times as many pixels.
    halves = F.avg_pool2d(field.mean(2), 2, ceil_mode=True, count_include_pad=False)
    low, high = (None if end is None else end / 2 for end in (first, last))
    found = 2 * disparity_map(halves[:, :, None], low, high).disparity
    return found.repeat_interleave(2, 0).repeat_interleave(2, 1)[:height, :width]
