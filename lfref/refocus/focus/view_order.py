"""Does the stored order of the views fit ours? With one axis reversed nothing but slope 0 comes into focus.

Reversing both axes only swaps the sign of the slope; reversing one of them destroys the parallax. The better order
is the one whose refocused planes, at slopes other than 0, hold more fine detail.
"""

import torch
from torch import Tensor

from lfref.refocus.shift.shift_and_sum import shift_and_sum

SLOPES = (-1.0, -0.75, -0.5, 0.5, 0.75, 1.0)
SIDE = 160  # pixels of the central crop that is looked at
MARGIN = 1.1  # a reversed order must be this much sharper: noise alone must not win


def detail(views: Tensor) -> float:
    """Fine detail of the sharpest plane at each pixel, averaged: squared Laplacian of the refocused planes.

    Args:
        views: Light field [V, U, C, H, W].
    """
    stack = shift_and_sum(views.mean(dim=-3, keepdim=True), list(SLOPES), border="edge")
    grey = stack[:, 0]
    laplacian = (
        4 * grey[:, 1:-1, 1:-1] - grey[:, :-2, 1:-1] - grey[:, 2:, 1:-1] - grey[:, 1:-1, :-2] - grey[:, 1:-1, 2:]
    )
    energy = torch.nn.functional.avg_pool2d(laplacian[None] ** 2, 9, stride=1)[0]
    return float(energy.amax(dim=0).mean())


def seems_reversed(views: Tensor) -> bool:
    """Whether the views focus better with one angular axis reversed (which one cannot be told, nor matters).

    Args:
        views: Light field [V, U, C, H, W]; only its centre is looked at.
    """
    height, width = views.shape[-2:]
    rows, columns = (slice(max(0, (n - SIDE) // 2), max(0, (n - SIDE) // 2) + SIDE) for n in (height, width))
    centre = _central_views(views)[..., rows, columns]
    if min(views.shape[:2]) < 2 or min(centre.shape[-2:]) < 32:
        return False
    return detail(centre.flip(0)) > MARGIN * detail(centre)


def _central_views(views: Tensor) -> Tensor:
    """At most 9x9 views: enough to tell, and none of them shifts by half of the crop."""
    rows, columns = (slice((n - min(n, 9)) // 2, (n + min(n, 9)) // 2) for n in views.shape[:2])
    return views[rows, columns]
