"""Refocusing by Wiener filters that follow the scene: of all disparities far from focus, of those of a block near it.

Far from focus, each surface is blurred by its own distance, wherever its light goes: filters for all disparities do
that (`separable_wiener`). Near focus, views are aliased and hide different things at edges: filters for the few
disparities of a block tell these apart (`block_filters`). In planes at whole slopes, where shifts read no view between
its pixels, the median of both and of shift-and-sum through cells is the picture: each is wrong somewhere there, seldom
two together.
Where views lie far apart, filters of rows and columns confuse light at different disparities. Near focus, those of all
views together (`joint_wiener`) take their place, and the picture is bounded by what the views show.
Letters: `s` slope, `d` disparity in pixels per view step, `N` planes.
"""

import torch
from torch import Tensor

from lfref import geometry
from lfref.functional import neighbours
from lfref.geometry import Slopes
from lfref.refocus import batches, block_filters, separable_wiener
from lfref.refocus.disparity.disparity_map import coarse_disparity
from lfref.refocus.fourier import disparity_layers
from lfref.refocus.fourier.disparity_layers import CONFUSABLE, Energies, bounded_by_views
from lfref.refocus.joint_wiener import prior_of_map, refocus_jointly
from lfref.refocus.operator import has_traits
from lfref.refocus.shift.shift_and_sum import shift_and_sum_antialiased

WHOLE = 0.1
"""Distance of a slope from a whole number within which the median fades in."""
AWAY, FADE = 1.7, 0.6
"""Distance of a plane from all disparities around, in pixels per view step, from which filters of rows and columns are
better in wide ranges too, and the range before it over which they fade in. By trial on the scene `deep` of sim30 and on
`sim30.WIDE`: from 1.3 to 1.7 their mean is the same to .1 dB, but with 1.3 one plane is 4 dB below shift-and-sum
through cells."""
RARE = 0.02
"""Share of the light at either end of a range that does not make it wide: gloss, highlights, and errors."""
LEAST_NOISE = 0.003
"""Least noise that filters of all views expect, as a share of the picture's variance: wrong disparities act like noise.
By trial on `sim30.WIDE` and `deep`: without it the mean is .2 dB lower, with .01 `deep` is .5 dB worse."""
AROUND = 17
"""Side of the square around a pixel whose disparities count, in pixels."""


@has_traits("predicts", symmetric=True)
def blockwise_wiener(
    views: Tensor, slopes: Slopes, weights: Tensor | None = None, disparities: Tensor | None = None
) -> Tensor:
    """Refocus light fields as a lens with the whole aperture would, with care for what is near focus.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W], more than one view.
        slopes: Focus in pixels per view step, [N].
        weights: Synthetic aperture, >= 0, symmetric about both axes, [V, U]; views of weight 0 are read too. None:
            all views alike.
        disparities: Of each pixel of the central view, in pixels per view step, [..., H, W]; None estimates them.

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views, [..., N, C, H, W].
        Derivatives leave out that disparities depend on the views.

    Raises:
        InputError: Views, slopes or weights that cannot be used.

    Example:
        >>> views = torch.rand(5, 5, 3, 48, 64)
        >>> lfref.blockwise_wiener(views, [-0.5, 0.5]).shape
        torch.Size([2, 3, 48, 64])
    """
    parts = blockwise_wiener_parts(views, slopes, weights, disparities)
    return parts[..., : views.shape[-3], :, :].contiguous()


@has_traits("predicts", symmetric=True)
def blockwise_wiener_parts(
    views: Tensor, slopes: Slopes, weights: Tensor | None = None, disparities: Tensor | None = None
) -> Tensor:
    """The stack of `blockwise_wiener`, and the pictures by filters for all disparities, side by side as channels."""
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    planes, aperture = geometry.checked_slopes(slopes, grid, size), batches.symmetric_weights(weights, grid)
    known = [None] * len(batch) if disparities is None else disparities.reshape(-1, *size)
    stacks = []
    for typed, known_disparity in zip(batch, known, strict=True):
        field = batches.radiance(typed)
        energies = disparity_layers.estimate_energies(field, separable_wiener.N_LAYERS, aperture)
        disparity = coarse_disparity(field) if known_disparity is None else known_disparity.to(field)
        noise = separable_wiener.noise_share(field, aperture, energies)
        prior = separable_wiener.finer(energies)
        everywhere = separable_wiener.refocus_by_rows_and_columns(field, planes, prior, aperture, noise)
        is_wide = _is_wide(energies)
        if is_wide:
            near = _nearness(disparity, planes)
            by_map = prior_of_map(disparity)._replace(noise=max(noise, LEAST_NOISE))
            joint = refocus_jointly(field, planes, by_map, aperture)
            everywhere = everywhere + near * (joint - everywhere)
        of_blocks, share = block_filters.refocus_by_blocks(field, planes, disparity, prior, aperture, noise)
        stack = everywhere + share * (of_blocks - everywhere)
        stack = _median_at_whole_slopes(stack, everywhere, field, planes, aperture)
        if is_wide:
            stack = stack + near * (bounded_by_views(stack, field, planes, energies, aperture) - stack)
        stacks.append(torch.cat([stack, everywhere], 1))
    return batches.restored(torch.stack(stacks), views)


def _is_wide(energies: Energies) -> bool:
    """Whether the range of all but rare disparities makes layers confuse light."""
    below = energies.shares.cumsum(0)
    common = energies.disparities[(below >= RARE) & (below - energies.shares <= 1 - RARE)]
    return float(common[-1] - common[0]) > CONFUSABLE


def _nearness(disparity: Tensor, planes: Tensor) -> Tensor:
    """1 where a disparity [H, W] around a pixel is near that of a plane, 0 where all are `AWAY`, [N, 1, H, W]."""
    distance = (disparity.detach() - planes.to(disparity)[:, None, None, None]).abs()
    return neighbours.box_max(((AWAY - distance) / FADE).clamp(0, 1), AROUND)


def _median_at_whole_slopes(
    stack: Tensor, everywhere: Tensor, field: Tensor, planes: Tensor, aperture: Tensor
) -> Tensor:
    """The stack [N, C, H, W]; in planes at whole slopes the median of it and the other two pictures, fading into it."""
    fractional = ((planes - planes.round()).abs() / WHOLE).clamp(max=1)
    whole = (fractional < 1).nonzero()[:, 0]
    if not len(whole):
        return stack
    cells, at = shift_and_sum_antialiased(field, planes[whole], aperture), whole.to(stack.device)
    middle = torch.stack([cells, stack[at], everywhere[at]]).median(0).values
    share = (1 - fractional[whole]).to(stack)[:, None, None, None]
    return stack.index_add(0, at, share * (middle - stack[at]))
