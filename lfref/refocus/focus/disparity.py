"""Disparity of what each pixel of the central view shows: the slope at which the views agree there.

Views shifted by the right slope show the same point, except those from which a nearer surface hides it. Of the slopes
tried, each pixel takes the one at which the fewest views disagree, all pixels together those that change seldom; then
comes what lies between the slopes, and flat regions take what their edges know. The parts are in `matching`.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.refocus import batches, lines
from lfref.refocus.matching import agreement, extent, grey, labels, refining


class DisparityMap(NamedTuple):
    """What `disparity_map` finds at each pixel of the central view."""

    disparity: Tensor
    """In pixels per view step, float32 or float64, [..., H, W]."""
    confidence: Tensor
    """How much better the views agree there than at other slopes on the whole, [0, 1), [..., H, W]."""


@torch.no_grad()
def disparity_map(
    views: Tensor,
    first: float | None = None,
    last: float | None = None,
    radius: float = 1.0,
    weights: Tensor | None = None,
    positions: Tensor | None = None,
) -> DisparityMap:
    """Find the disparity of every pixel, on the CPU.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W], more than one view.
        first: Least disparity to look for, in pixels per view step; None looks for it.
        last: Largest disparity to look for, likewise.
        radius: Standard deviation of the window in which views are compared, in pixels.
        weights: Which views to look at: those of weight 0 are not, [V, U]; None looks at all.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Returns:
        Disparity and confidence, on the device of the views. No gradients.

    Raises:
        InputError: Views, a range, a radius, weights or positions that cannot be used.

    Example:
        >>> views = torch.rand(5, 5, 3, 64, 64)
        >>> lfref.disparity_map(views, -1, 1).disparity.shape
        torch.Size([64, 64])
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    if max(grid) < 2:
        raise InputError("disparity takes more than one view", got=f"a grid of {grid[0]}x{grid[1]}")
    if not (math.isfinite(radius) and radius >= 0):
        raise InputError("radius must be finite and at least 0", got=radius, remedy="in pixels; 1 is the default")
    aperture = batches.checked_weights(weights, grid)
    found = [_found(field, aperture, positions, first, last, radius) for field in batch]
    shape, dtype = (*views.shape[:-5], *size), batches.working_dtype(views.dtype)
    return DisparityMap(
        *(torch.stack(maps).reshape(shape).to(views.device, dtype) for maps in zip(*found, strict=True))
    )


def _found(
    views: Tensor,
    aperture: Tensor,
    positions: Tensor | None,
    first: float | None,
    last: float | None,
    radius: float,
) -> tuple[Tensor, Tensor]:
    """Disparity and confidence of one light field, [H, W] each."""
    low, high = _range(views, aperture, positions, first, last)
    slopes = lines.checked_slopes(labels.slopes_between(low, high), *batches.grid_and_size(views), positions)
    light = grey.grey_views(views, aperture, positions)
    noise = agreement.noise(light, slopes)
    disparity, confidence = labels.best_slopes(light, slopes, noise, radius)
    return refining.refined(light, disparity, noise, low, high), confidence


def _range(
    views: Tensor, aperture: Tensor, positions: Tensor | None, first: float | None, last: float | None
) -> tuple[float, float]:
    """The slopes between which to look, as asked for or as the field itself says."""
    if first is None or last is None:
        low, high = extent.found(views, aperture, positions)
        first, last = (low if first is None else first), (high if last is None else last)
    if not (math.isfinite(first) and math.isfinite(last) and first <= last):
        raise InputError("disparities must lie between a first and a larger last one", got=f"{first} and {last}")
    return first, last
