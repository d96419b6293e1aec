"""Refocusing by Wiener filters that follow the scene: of all disparities far from focus, of those of a block near it.

Far from focus, each surface is blurred by its own distance, wherever its light goes: filters for all disparities do
that (`separable_wiener`). Near focus, views are aliased and hide different things at edges: filters for the few
disparities of a block tell these apart (`block_filters`). In focus, the picture is bounded by what the views show.
Where views lie far apart, filters of rows and columns confuse light at different disparities. Near focus, those of all
views together (`joint_wiener`) take their place.
Letters: `s` slope, `d` disparity in pixels per view step, `N` planes.
"""

from collections.abc import Iterator

import torch
from torch import Tensor

from lfref import geometry
from lfref.functional import neighbours
from lfref.functional.devices import on_device
from lfref.geometry import Slopes
from lfref.refocus import batches, block_filters, separable_wiener
from lfref.refocus.bounds import bounded_by_views
from lfref.refocus.joint_wiener import prior_of_map, refocus_jointly
from lfref.refocus.operator import has_traits
from lfref.refocus.scene import Scene, scenes_of

AWAY, FADE = 1.7, 0.6
"""Distance of a plane from all disparities around, in pixels per view step, from which filters of rows and columns are
better in wide ranges too, and the range before it over which they fade in. By trial on the scene `deep` of sim30 and on
`sim30.WIDE`: from 1.3 to 1.7 their mean is the same to .1 dB, but with 1.3 one plane is 4 dB below shift-and-sum
through cells."""
AROUND = 17
"""Side of the square around a pixel whose disparities count, in pixels."""


@has_traits("predicts", symmetric=True)
def blockwise_wiener(
    views: Tensor,
    slopes: Slopes,
    weights: Tensor | None = None,
    disparities: Tensor | None = None,
    scene: Scene | None = None,
) -> Tensor:
    """Refocus light fields as a lens with the whole aperture would, with care for what is near focus.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W], more than one view.
        slopes: Focus in pixels per view step, [N].
        weights: Synthetic aperture, >= 0, symmetric about both axes, [V, U]; views of weight 0 are read too. None:
            all views alike.
        disparities: Of each pixel of the central view, in pixels per view step, [..., H, W]; None estimates them.
        scene: What `analyze_scene` found in this one light field; None: it is analyzed.

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
    return batches.restored(list(_refocused(views, slopes, weights, disparities, scene)), views)


def _refocused(
    views: Tensor, slopes: Slopes, weights: Tensor | None, disparities: Tensor | None, scene: Scene | None
) -> Iterator[Tensor]:
    """Of each light field the stack, [N, C, H, W]."""
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    planes, aperture = geometry.checked_slopes(slopes, grid, size), batches.symmetric_weights(weights, grid)
    known = [None] * len(batch) if disparities is None else disparities.reshape(-1, *size)
    for own, known_disparity in zip(scenes_of(batch, scene, weights), known, strict=True):
        field, noise = own.light, own.noise
        disparity = own.disparity if known_disparity is None else known_disparity.to(field)
        prior = separable_wiener.finer(own.energies)
        everywhere = separable_wiener.refocus_by_rows_and_columns(field, planes, prior, aperture, noise)
        if own.known is not None and own.known.is_wide:
            near = _nearness(disparity, planes)
            by_map = prior_of_map(disparity, own.widest, noise)
            joint = refocus_jointly(field, planes, by_map, aperture)
            everywhere = everywhere + near * (joint - everywhere)
        of_blocks, share = block_filters.refocus_by_blocks(own, planes, disparity, prior, aperture)
        stack = torch.lerp(everywhere, of_blocks, share)
        yield bounded_by_views(stack, own, planes, aperture)


def _nearness(disparity: Tensor, planes: Tensor) -> Tensor:
    """1 where a disparity [H, W] around a pixel is near that of a plane, 0 where all are `AWAY`, [N, 1, H, W]."""
    slopes = on_device(planes, disparity.device, disparity.dtype)
    distance = (disparity.detach() - slopes[:, None, None, None]).abs()
    return neighbours.box_max(((AWAY - distance) / FADE).clamp(0, 1), AROUND)
