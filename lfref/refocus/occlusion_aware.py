"""Refocusing that knows where surfaces hide each other: layers everywhere, the Wiener estimate at edges near focus.

Layers (`refocus_by_layers`) blur each surface by its own distance from the focus, and are exact where one surface
fills the neighbourhood. At the edge of a surface near focus views are aliased and hide different things; there the
Wiener estimate, which models the folds of frequencies, is the better one by some decibels. Which pixels are near
such an edge is read from the map of disparities.
Letters: `s` slope, `d` disparity in pixels per view step.
"""

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.functional.neighbours import box_max, box_mean
from lfref.geometry import Slopes
from lfref.refocus import batches, wiener_filters
from lfref.refocus.disparity.disparity_map import coarse_disparity
from lfref.refocus.fourier import layer_energies
from lfref.refocus.fourier.disparity_layers import by_energies
from lfref.refocus.wiener import checked_aperture, wiener

N_LAYERS = 12
EDGE = 0.12  # change of disparity from pixel to pixel that is a gap, not a slant
NEAR = 7  # pixels around an edge
FOCUS = 1.0  # |s - d| in pixels per view step from which aliases no longer matter
WHOLE = 0.1  # distance from whole slopes from which on shifts count as fractional
FADE = 5  # pixels over which one estimate gives way to the other


def occlusion_aware(
    views: Tensor, slopes: Slopes, weights: Tensor | None = None, disparities: Tensor | None = None
) -> Tensor:
    """Refocus light fields as a lens with the whole aperture would, with care for edges near focus.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W], more than one view.
        slopes: Focus in pixels per view step, [N].
        weights: Synthetic aperture, >= 0, alike on both sides of both axes, [V, U]; None weighs all views alike.
        disparities: Of each pixel of the central view, if they are known, in pixels per view step, [..., H, W].

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views, [..., N, C, H, W].
        Derivatives leave out that disparities depend on the views.

    Raises:
        InputError: Views, slopes, weights or disparities that cannot be used.

    Example:
        >>> views = torch.rand(5, 5, 3, 48, 64)
        >>> lfref.occlusion_aware(views, [-0.5, 0.5]).shape
        torch.Size([2, 3, 48, 64])
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    planes, aperture = geometry.checked_slopes(slopes, grid, size), checked_aperture(weights, grid)
    known = [None] * len(batch) if disparities is None else _checked(disparities, views)
    stacks = [
        _refocused(batches.radiance(field), planes, aperture, found) for field, found in zip(batch, known, strict=True)
    ]
    return batches.restored(torch.stack(stacks), views)


def _refocused(field: Tensor, planes: Tensor, aperture: Tensor, known: Tensor | None) -> Tensor:
    """One light field [V, U, C, H, W] as a stack [N, C, H, W]."""
    energies = layer_energies.found(field, N_LAYERS, aperture)
    first, *_, last = energies.disparities.tolist()
    disparity = coarse_disparity(field, first, last) if known is None else known
    stack, shares = by_energies(field, planes, energies, aperture), near_edges(disparity, planes)
    needed = shares.amax((1, 2)).cpu() > 0
    if bool(needed.any()):
        estimate = wiener(field, planes[needed], wiener_filters.found_in(disparity), aperture)
        chosen = needed.nonzero()[:, 0].to(stack.device)
        stack = stack.index_add(0, chosen, shares[chosen, None] * (estimate - stack[chosen]))
    return stack


def _checked(disparities: Tensor, views: Tensor) -> Tensor:
    """Disparities with at least one axis before rows and columns, once they are known to belong to views.

    Raises:
        InputError: They do not.
    """
    wanted = (*views.shape[:-5], *views.shape[-2:])
    if disparities.shape != wanted or not bool(disparities.isfinite().all()):
        raise InputError(f"disparities must be finite, of shape {wanted}", got=tuple(disparities.shape))
    return disparities.reshape(-1, *wanted[-2:])


def near_edges(disparity: Tensor, planes: Tensor) -> Tensor:
    """How far each pixel of each plane is one that the edge of a surface near focus touches, [0, 1], [N, H, W].

    Args:
        disparity: In pixels per view step, [H, W].
        planes: Slopes, [N].
    """
    window = 2 * NEAR + 1
    edges = (box_max(disparity, 3) + box_max(-disparity, 3) > EDGE).to(disparity)
    farthest, nearest, slopes = -box_max(-disparity, window), box_max(disparity, window), planes.to(disparity)
    distance = torch.maximum(farthest - slopes[:, None, None], slopes[:, None, None] - nearest)
    # Whole shifts read no view between its pixels: what aliases there does so in the photograph too.
    between = ((slopes - slopes.round()).abs() / WHOLE).clamp(max=1)[:, None, None]
    shares = between * box_max(edges, window) * ((FOCUS - distance) / (0.3 * FOCUS)).clamp(0, 1)
    return box_mean(shares, FADE)
