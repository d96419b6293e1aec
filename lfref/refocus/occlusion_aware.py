"""Refocusing that knows where surfaces hide each other: layers everywhere, the Wiener estimate at edges near focus.

Layers (`refocus_by_layers`) blur each surface by its own distance from the focus, and are exact where one surface
fills the neighbourhood. At the edge of a surface near focus views are aliased and hide different things; there the
Wiener estimate, which models the folds of frequencies, is better by some decibels:
`I_s = (1 - a_s) layers_s + a_s wiener_s`, the share a_s of each pixel from the disparity map (`edge_shares`).
Where views lie far apart, both confuse light at different disparities, and the picture is bounded by what the views
show (`bounded_by_views`); where layers do not fit at all (`exceeds_layers`), shift-and-sum through cells makes it.
Letters: `s` slope, `d` disparity in pixels per view step, `N` planes.
"""

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.functional.neighbours import box_max, box_mean
from lfref.geometry import Slopes
from lfref.refocus import batches, wiener_filters
from lfref.refocus.disparity.disparity_map import coarse_disparity
from lfref.refocus.fourier import disparity_layers
from lfref.refocus.fourier.disparity_layers import bounded_by_views, refocus_by_energies
from lfref.refocus.shift.shift_and_sum import shift_and_sum_through_cells
from lfref.refocus.wiener import wiener

EDGE = 0.12
"""Change of disparity within 3 pixels, in pixels per view step, that is a gap between surfaces and not a slant."""
NEAR = 7
"""Pixels around an edge that views see past it: three view steps times a gap of 2.3 pixels per view step."""
FOCUS = 1.0
"""|s - d| in pixels per view step from which blur hides the aliases."""


def occlusion_aware(
    views: Tensor, slopes: Slopes, weights: Tensor | None = None, disparities: Tensor | None = None
) -> Tensor:
    """Refocus light fields as a lens with the whole aperture would, with care for edges near focus.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W], more than one view.
        slopes: Focus in pixels per view step, [N].
        weights: Synthetic aperture, >= 0, symmetric about both axes, [V, U]; None weighs all views alike.
        disparities: Of each pixel of the central view, in pixels per view step, [..., H, W]; None estimates them.

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
    planes, aperture = geometry.checked_slopes(slopes, grid, size), batches.symmetric_weights(weights, grid)
    shape = (*views.shape[:-5], *size)
    if disparities is not None and not (disparities.shape == shape and bool(disparities.isfinite().all())):
        raise InputError(f"disparities must be finite, of shape {shape}", got=tuple(disparities.shape))
    known = [None] * len(batch) if disparities is None else disparities.reshape(-1, *size)
    stacks = []
    for typed, known_disparity in zip(batch, known, strict=True):
        field = batches.radiance(typed)
        energies = disparity_layers.estimate_energies(field, 12, aperture)
        if disparity_layers.exceeds_layers(energies, field, aperture):
            stacks.append(shift_and_sum_through_cells(field, planes, aperture))
            continue
        first, *_, last = energies.disparities.tolist()
        disparity = coarse_disparity(field, first, last) if known_disparity is None else known_disparity
        stack, shares = refocus_by_energies(field, planes, energies, aperture), edge_shares(disparity, planes)
        # The estimate is the costly part: only planes in which some pixel takes it are estimated.
        needed = shares.amax((1, 2)).cpu() > 0
        if bool(needed.any()):
            estimate = wiener(field, planes[needed], wiener_filters.prior_of_map(disparity), aperture)
            at = needed.nonzero()[:, 0].to(stack.device)
            stack = stack.index_add(0, at, shares[at, None] * (estimate - stack[at]))
        stacks.append(bounded_by_views(stack, field, planes, energies, aperture))
    return batches.restored(torch.stack(stacks), views)


def edge_shares(disparity: Tensor, planes: Tensor) -> Tensor:
    """How far the edge of a surface near focus touches each pixel of each plane, in [0, 1], [N, H, W].

    Args:
        disparity: In pixels per view step, [H, W].
        planes: Slopes, [N].
    """
    window = 2 * NEAR + 1
    edges = (box_max(disparity, 3) + box_max(-disparity, 3) > EDGE).to(disparity)
    # Distance of the focus from the range of disparities around the pixel: negative within it.
    low, high, slopes = -box_max(-disparity, window), box_max(disparity, window), planes.to(disparity)
    distance = torch.maximum(low - slopes[:, None, None], slopes[:, None, None] - high)
    near_focus = ((FOCUS - distance) / (0.3 * FOCUS)).clamp(0, 1)
    # Whole shifts read no view between its pixels, and alias as the photograph does: within .1 of them layers fade in.
    fractional = ((slopes - slopes.round()).abs() / 0.1).clamp(max=1)[:, None, None]
    return box_mean(fractional * box_max(edges, window) * near_focus, 5)  # without seams between both pictures
