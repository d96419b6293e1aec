"""Disparity of what each pixel of the central view shows: the slope at which all views agree there.

Views shifted by the right slope show the same point, so that their variance has its least there. Where a nearer
surface hides the point from part of the aperture, a half of the aperture still agrees: the least of the variances over
the whole aperture and its four halves counts.
Letters: `s` slope in pixels per view step, `N` slopes tried.
Source: Vaish et al., "Reconstructing Occluded Surfaces using Synthetic Apertures", 2006 (variance as a cost); halves
of the aperture after Chen et al., "Light Field Stereo Matching Using Bilateral Statistics", 2014.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.refocus import batches, windows
from lfref.refocus.fourier import layer_energies
from lfref.refocus.shift.shift_and_sum import shift_and_sum

STEP = 0.1  # slopes tried, in pixels per view step: parabolas find the least between them
HALF_PENALTY = 1.5  # a half has fewer views that could disagree
FLOOR = 1e-6  # variance of views that agree as well as 8 bits can say


class DisparityMap(NamedTuple):
    """What `disparity_map` finds at each pixel of the central view."""

    disparity: Tensor
    """In pixels per view step, float32 or float64, [..., H, W]."""
    confidence: Tensor
    """How much better the views agree there than at other slopes on the whole, [0, 1), [..., H, W]."""


@torch.no_grad()
def disparity_map(
    views: Tensor, first: float | None = None, last: float | None = None, radius: float = 1.5
) -> DisparityMap:
    """Find the disparity of every pixel.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W], more than one view.
        first: Least disparity to look for, in pixels per view step; None looks for it.
        last: Largest disparity to look for, likewise.
        radius: Standard deviation of the window in which views are compared, in pixels.

    Returns:
        Disparity and confidence. No gradients.

    Raises:
        InputError: Views or a range that cannot be used.

    Example:
        >>> views = torch.rand(5, 5, 3, 64, 64)
        >>> lfref.disparity_map(views, -1, 1).disparity.shape
        torch.Size([64, 64])
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    if max(grid) < 2:
        raise InputError("disparity takes more than one view", got=f"a grid of {grid[0]}x{grid[1]}")
    light = batches.radiance(batch).mean(3, keepdim=True)
    found = [_found(field, *_range(field, first, last), radius) for field in light]
    shape = (*views.shape[:-5], *size)
    return DisparityMap(*(torch.stack(maps).reshape(shape) for maps in zip(*found, strict=True)))


def _range(views: Tensor, first: float | None, last: float | None) -> tuple[float, float]:
    """The slopes between which to look, as asked for or as the field's own spectra say."""
    if first is None or last is None:
        aperture = batches.checked_weights(None, (views.shape[0], views.shape[1]))
        seen = layer_energies.found(views, 2, aperture).disparities
        first, last = (float(seen[0]) if first is None else first), (float(seen[-1]) if last is None else last)
    if not (math.isfinite(first) and math.isfinite(last) and first <= last):
        raise InputError("disparities must lie between a first and a larger last one", got=f"{first} and {last}")
    return first, last


def _found(views: Tensor, first: float, last: float, radius: float) -> tuple[Tensor, Tensor]:
    """Disparity and confidence of one light field, [H, W] each."""
    slopes = torch.linspace(first, last, 1 + math.ceil((last - first) / STEP - 1e-9), dtype=torch.float64)
    cost = _cost(views, slopes, radius)
    best = cost.argmin(0, keepdim=True)
    step = float(slopes[1] - slopes[0]) if len(slopes) > 1 else 0.0
    disparity = first + step * (best + _least(cost, best))[0]
    least, mean = cost.gather(0, best)[0], cost.mean(0)
    return disparity.to(views.dtype), (mean - least) / (mean + FLOOR)


def _cost(views: Tensor, slopes: Tensor, radius: float) -> Tensor:
    """Variance of the shifted views [V, U, 1, H, W] at each slope, [N, H, W]."""
    light = torch.cat([views, views.square()], 2)
    costs = []
    for weights in _apertures(views.shape[0], views.shape[1]):
        mean, square = shift_and_sum(light, slopes, "cubic", weights=weights).unbind(1)
        costs.append(windows.smoothed((square - mean.square()).clamp(min=0), radius))
    whole, *halves = costs
    return torch.stack([whole, *(HALF_PENALTY * half for half in halves)]).amin(0) + FLOOR


def _apertures(n_rows: int, n_columns: int) -> list[Tensor]:
    """The whole aperture and its halves, of those axes along which there is more than one view, [V, U] each."""
    v, u = (geometry.angular_offsets(n) for n in (n_rows, n_columns))
    ones, apertures = torch.ones(n_rows, n_columns, dtype=torch.float64), []
    for places, is_axis in ((v[:, None], n_rows > 1), (u, n_columns > 1)):
        apertures += [ones * (sign * places >= 0) for sign in (1, -1)] if is_axis else []
    return [ones, *apertures]


def _least(cost: Tensor, best: Tensor) -> Tensor:
    """Where a parabola through the least cost and its neighbours has its least, in slopes from it, [1, H, W]."""
    last = len(cost) - 1
    before, here, after = (cost.gather(0, (best + step).clamp(0, last)) for step in (-1, 0, 1))
    rise_before, rise_after = before - here, after - here
    offset = (rise_before - rise_after) / (2 * (rise_before + rise_after) + FLOOR**2)
    return torch.where((best > 0) & (best < last), offset, 0.0)
