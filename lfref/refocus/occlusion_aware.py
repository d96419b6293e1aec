"""Refocusing that knows where surfaces hide each other: layers far from focus, the Wiener estimate near focus.

Layers (`refocus_by_layers`) blur each surface by its own distance from the focus, and are exact where one surface
fills the neighbourhood. Near focus, views are aliased and hide different things at edges; there the Wiener estimate,
which models the folds of frequencies, is better by some decibels: `I_s = (1 - a_s) layers_s + a_s wiener_s`, the share
a_s of each pixel from the disparity map (`near_shares`). In planes at whole slopes, where shifts read no view between
its pixels, the median of layers, estimate and shift-and-sum through cells takes the place of the estimate: each of them
is wrong somewhere there, and seldom two of them together.
Where views lie far apart, both confuse light at different disparities, and the picture is bounded by what the views
show (`bounded_by_views`); where layers do not fit at all (`exceeds_layers`), shift-and-sum through cells makes it.
Letters: `s` slope, `d` disparity in pixels per view step, `N` planes.
"""

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.functional import memory
from lfref.functional.neighbours import box_max, box_mean
from lfref.geometry import Slopes
from lfref.refocus import batches, wiener_filters
from lfref.refocus.disparity import cost_volume, matching
from lfref.refocus.disparity.disparity_map import coarse_disparity
from lfref.refocus.fourier import disparity_layers
from lfref.refocus.fourier.disparity_layers import bounded_by_views, refocus_by_energies
from lfref.refocus.shift.shift_and_sum import shift_and_sum_through_cells
from lfref.refocus.wiener import wiener

NEAR = 7
"""Pixels around a surface that views see past its edge: three view steps times a gap of 2.3 pixels per view step."""
FOCUS = 1.0
"""|s - d| in pixels per view step from which blur hides the aliases."""
WHOLE = 0.1
"""Distance of a slope from a whole number within which the median fades in."""
UNEXPLAINED = 0.02
"""`Prior.unexplained`: between .01 and .03, by trial on both versions of sim30."""
NOISE = 3.0
"""Variance of the noise over what is measured, between samples, where interpolation averages half of it out. By trial:
1.5 leaves .15 dB on sim30 with noise of .02."""


def occlusion_aware(
    views: Tensor, slopes: Slopes, weights: Tensor | None = None, disparities: Tensor | None = None
) -> Tensor:
    """Refocus light fields as a lens with the whole aperture would, with care for what is near focus.

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
    parts = occlusion_aware_parts(views, slopes, weights, disparities)
    return parts[..., : views.shape[-3], :, :].contiguous()


def occlusion_aware_parts(
    views: Tensor, slopes: Slopes, weights: Tensor | None = None, disparities: Tensor | None = None
) -> Tensor:
    """The stack of `occlusion_aware`, and the pictures of layers and of the Wiener estimate that it is made of.

    Arguments and errors are those of `occlusion_aware`. A plane without a Wiener estimate has the stack in its place;
    where shift-and-sum through cells made the stack, it is all three pictures.

    Returns:
        Stack, layers and estimate side by side as channels, [..., N, 3 C, H, W].
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
        memory.trim_for(field)
        energies = disparity_layers.estimate_energies(field, 12, aperture)
        if disparity_layers.exceeds_layers(energies, field, aperture):
            cells = shift_and_sum_through_cells(field, planes, aperture)
            stacks.append(torch.cat([cells] * 3, 1))
            continue
        first, *_, last = energies.disparities.tolist()
        known_disparity = None if known_disparity is None else known_disparity.to(field)
        disparity = coarse_disparity(field, first, last) if known_disparity is None else known_disparity
        memory.trim_for(field)
        layers, shares = refocus_by_energies(field, planes, energies, aperture), near_shares(disparity, planes)
        stack, estimates = layers, {}
        # The estimate is the costly part: only planes in which some pixel takes it are estimated.
        needed = (shares.amax((1, 2)).cpu() > 0).nonzero()[:, 0]
        if len(needed):
            memory.trim_for(field)
            noise = noise_share(field, aperture, first, last)
            prior = wiener_filters.prior_of_map(disparity)._replace(unexplained=UNEXPLAINED, noise=noise)
            estimate, at = wiener(field, planes[needed], prior, aperture), needed.to(layers.device)
            estimates = dict(zip(needed.tolist(), estimate, strict=True))
            middle = _median_at_whole_slopes(field, planes[needed], layers[at], estimate, aperture)
            stack = layers.index_add(0, at, shares[at, None] * (middle - layers[at]))
        stack = bounded_by_views(stack, field, planes, energies, aperture)
        estimate = torch.stack([estimates.get(plane, picture) for plane, picture in enumerate(stack)])
        stacks.append(torch.cat([stack, layers, estimate], 1))
    return batches.restored(torch.stack(stacks), views)


def near_shares(disparity: Tensor, planes: Tensor) -> Tensor:
    """How near to focus the surfaces around each pixel are in each plane, in [0, 1], [N, H, W].

    Args:
        disparity: In pixels per view step, [H, W].
        planes: Slopes, [N].
    """
    window = 2 * NEAR + 1
    # Distance of the focus from the range of disparities around the pixel: negative within it.
    low, high, slopes = -box_max(-disparity, window), box_max(disparity, window), planes.to(disparity)[:, None, None]
    distance = torch.maximum(low - slopes, slopes - high)
    return box_mean(((FOCUS - distance) / (0.3 * FOCUS)).clamp(0, 1), 5)  # without seams between both pictures


def noise_share(field: Tensor, aperture: Tensor, first: float, last: float) -> float:
    """`Prior.noise` of a light field [V, U, C, H, W] whose disparities lie between first and last."""
    light = cost_volume.grey_views(field, aperture)
    noise = cost_volume.noise(light, matching.slopes_between(first, last))
    # Noise of the channels is independent, and their mean has less of it.
    noisy, variance = NOISE * field.shape[2] * noise**2, float(light.central.var())
    return noisy / max(variance - noise**2, noisy, torch.finfo(torch.float32).tiny)


def _median_at_whole_slopes(
    field: Tensor, planes: Tensor, layers: Tensor, estimate: Tensor, aperture: Tensor
) -> Tensor:
    """The estimate [N, C, H, W]; the median of the three pictures in planes at whole slopes, fading into it."""
    fractional = ((planes - planes.round()).abs() / WHOLE).clamp(max=1)
    whole = (fractional < 1).nonzero()[:, 0]
    if not len(whole):
        return estimate
    cells, at = shift_and_sum_through_cells(field, planes[whole], aperture), whole.to(estimate.device)
    middle = torch.stack([cells, layers[at], estimate[at]]).median(0).values
    share = (1 - fractional[whole]).to(estimate)[:, None, None, None]
    return estimate.index_add(0, at, share * (middle - estimate[at]))
