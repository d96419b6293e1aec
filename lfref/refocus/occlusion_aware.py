"""Refocusing by Wiener filters that follow the scene: of all disparities far from focus, of those of a block near it.

Far from focus, each surface is blurred by its own distance, wherever its light goes: filters for all disparities do
that (`separable_wiener`). Near focus, views are aliased and hide different things at edges: filters for the few
disparities of a block tell these apart (`block_filters`). In planes at whole slopes, where shifts read no view between
its pixels, the median of both and of shift-and-sum through cells is the picture: each is wrong somewhere there, seldom
two together.
Where views lie far apart, both confuse light at different disparities, and the picture is bounded by what the views
show (`bounded_by_views`); where they move too far (`exceeds_layers`), shift-and-sum through cells makes it.
Letters: `s` slope, `d` disparity in pixels per view step, `N` planes.
"""

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.functional import memory
from lfref.geometry import Slopes
from lfref.refocus import batches, block_filters, separable_wiener
from lfref.refocus.disparity import cost_volume, matching
from lfref.refocus.disparity.disparity_map import coarse_disparity
from lfref.refocus.fourier import disparity_layers
from lfref.refocus.fourier.disparity_layers import bounded_by_views
from lfref.refocus.shift.shift_and_sum import shift_and_sum_through_cells

WHOLE = 0.1
"""Distance of a slope from a whole number within which the median fades in."""
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
    """The stack of `occlusion_aware`, and the pictures by filters for all disparities.

    Arguments and errors are those of `occlusion_aware`. Where shift-and-sum through cells made the stack, it is both.

    Returns:
        Stack, and pictures for all disparities, side by side as channels, [..., N, 2 C, H, W].
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
        energies = disparity_layers.estimate_energies(field, separable_wiener.N_LAYERS, aperture)
        if disparity_layers.exceeds_layers(energies, field, aperture):
            cells = shift_and_sum_through_cells(field, planes, aperture)
            stacks.append(torch.cat([cells] * 2, 1))
            continue
        first, *_, last = energies.disparities.tolist()
        disparity = coarse_disparity(field) if known_disparity is None else known_disparity.to(field)
        memory.trim_for(field)
        noise = noise_share(field, aperture, first, last)
        prior = separable_wiener.finer(energies)
        everywhere = separable_wiener.refocus_by_rows_and_columns(field, planes, prior, aperture, noise)
        blocks = block_filters.refocus_by_blocks(field, planes, disparity, prior, aperture, noise)
        stack = everywhere + blocks.nearness * (blocks.stack - everywhere)
        stack = _median_at_whole_slopes(stack, everywhere, field, planes, aperture)
        stacks.append(torch.cat([bounded_by_views(stack, field, planes, energies, aperture), everywhere], 1))
    return batches.restored(torch.stack(stacks), views)


def noise_share(field: Tensor, aperture: Tensor, first: float, last: float) -> float:
    """`AxisSpectrum.noise` of a light field [V, U, C, H, W] whose disparities lie between first and last."""
    light = cost_volume.grey_views(field, aperture)
    noise = cost_volume.noise(light, matching.slopes_between(first, last))
    # Noise of the channels is independent, and their mean has less of it.
    noisy, variance = NOISE * field.shape[2] * noise**2, float(light.central.var())
    return noisy / max(variance - noise**2, noisy, torch.finfo(torch.float32).tiny)


def _median_at_whole_slopes(
    stack: Tensor, everywhere: Tensor, field: Tensor, planes: Tensor, aperture: Tensor
) -> Tensor:
    """The stack [N, C, H, W]; in planes at whole slopes the median of it and the other two pictures, fading into it."""
    fractional = ((planes - planes.round()).abs() / WHOLE).clamp(max=1)
    whole = (fractional < 1).nonzero()[:, 0]
    if not len(whole):
        return stack
    cells, at = shift_and_sum_through_cells(field, planes[whole], aperture), whole.to(stack.device)
    middle = torch.stack([cells, stack[at], everywhere[at]]).median(0).values
    share = (1 - fractional[whole]).to(stack)[:, None, None, None]
    return stack.index_add(0, at, share * (middle - stack[at]))
