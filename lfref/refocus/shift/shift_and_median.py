"""Medians of shifted views: what most views show of each point of a plane, so that thin things before it vanish.

Leaves and fences before the plane lie elsewhere in each view. The mean spreads them over the picture, the median leaves
them out where they cover less than half of the aperture.
Source: Vaish et al., "Reconstructing Occluded Surfaces using Synthetic Apertures", 2006.
"""

import torch
from torch import Tensor

from lfref.errors import chosen
from lfref.geometry import Slopes
from lfref.refocus import batches
from lfref.refocus.operator import has_traits
from lfref.refocus.sampling import BORDERS, INTERPOLATIONS
from lfref.refocus.shift.shift_and_sum import summed
from lfref.refocus.shift.shifts import shifts_of


@has_traits("compares")
def shift_and_median(
    views: Tensor,
    slopes: Slopes,
    interpolation: str = "linear",
    weights: Tensor | None = None,
    positions: Tensor | None = None,
) -> Tensor:
    """Refocus light fields by the median of the shifted views that have a sample there; each channel for itself.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        interpolation: `nearest`, `linear`, `cubic` or `spline`.
        weights: Synthetic aperture, >= 0, [V, U]: the median of views of these weights; None weighs all views alike.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views, [..., N, C, H, W].

    Raises:
        InputError: Views, slopes, weights, positions or names that cannot be used.

    Example:
        >>> views = torch.rand(5, 5, 3, 32, 48)
        >>> lfref.shift_and_median(views, [-0.5, 0, 0.5]).shape
        torch.Size([3, 3, 32, 48])
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    planes = batches.checked_slopes(slopes, grid, size, positions)
    method, border = chosen("interpolation", interpolation, INTERPOLATIONS), BORDERS["renormalize"]
    aperture = batches.checked_weights(weights, grid)
    cameras = batches.even(grid) if positions is None else batches.checked_positions(positions, grid)
    whole = torch.ones(1, 1, dtype=torch.float64)
    stack = []
    for plane in planes.split(1):
        shifted, trust = [], []
        for v, u in aperture.nonzero().tolist():
            shifts = shifts_of(plane, (1, 1), method, cameras[v : v + 1, u : u + 1])
            shifted.append(summed(batch[:, v : v + 1, u : u + 1], shifts, None, whole, method, border)[:, 0])
            trust.append(aperture[v, u] * (shifts.coverage(whole, size, border)[0][0] > 0))
        stack.append(weighted_median(torch.stack(shifted), torch.stack(trust).to(shifted[0])))
    return batches.restored(torch.stack(stack, 1), views)


def weighted_median(samples: Tensor, weights: Tensor) -> Tensor:
    """Median of samples [K, ..., H, W] of weights [K, H, W] >= 0; the mean of two where either side weighs half."""
    samples, order = samples.sort(0)
    share = weights[:, None, None].expand_as(samples).gather(0, order).cumsum(0)
    half, rounding = share[-1:] / 2, 1e-5 * share[-1:]
    ends = [(share < half + room).sum(0, keepdim=True).clamp(max=len(share) - 1) for room in (-rounding, rounding)]
    low, high = (samples.gather(0, end)[0] for end in ends)
    return (low + high) / 2
