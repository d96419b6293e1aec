"""What stands in for samples that are not to be trusted, for methods that look at the views instead of summing them.

A sum leaves such samples out. An estimate that is told of views times their weight, or reads what a missing view holds,
goes wrong: on the `vignetting` scene of sim30, divided by its gain, occlusion-aware refocusing of weighted views has
47.7 dB against truth, of filled ones 54.9; with its four corner views missing `discs` has 35.8 dB, with them foretold
57.8 (59.4 with all views).
Letters: `V U` view rows and columns.
"""

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.refocus.fourier.disparity_layers import disparity_layers

LEAST = 0.05  # of the weight that a light field has at best: samples of less show nothing by themselves
TRUSTED = 0.1  # of the weight that the most trusted view has at a pixel: less gives way


def filled(views: Tensor, weight: Tensor) -> Tensor:
    """Views whose samples of little weight give way to the weighted mean of all views there.

    Args:
        views: Floating point, [..., V, U, C, H, W].
        weight: How far each sample is to be trusted, >= 0, in the type of the views, [..., V, U, 1, H, W].

    Returns:
        The views where they have a tenth or more of the largest weight at a pixel; black where no view has any.
    """
    needed = TRUSTED * weight.amax((-5, -4), keepdim=True)
    # Most pixels have no sample that must give way: only the others are worked on.
    y, x = ((weight < needed) | (needed == 0)).flatten(0, -3).any(0).nonzero(as_tuple=True)
    if len(y) == 0:
        return views
    made = views.clone()
    made[..., y, x] = _given_way(views[..., y, x], weight[..., y, x], needed[..., y, x])
    return made


def _given_way(samples: Tensor, weight: Tensor, needed: Tensor) -> Tensor:
    """Samples [..., V, U, C, P] of less weight than is needed, as far as that, replaced by the mean of the views."""
    least, samples = torch.finfo(weight.dtype).tiny, torch.where(weight > 0, samples, 0)
    mean = (samples * weight).sum((-4, -3), keepdim=True) / weight.sum((-4, -3), keepdim=True).clamp(min=least)
    return torch.lerp(mean.expand_as(samples), samples, (weight / needed.clamp(min=least)).clamp(max=1))


def trusted(weight: Tensor) -> Tensor:
    """Which samples have enough weight to show by themselves what is there: interpolated weights are seldom quite 0.

    Args:
        weight: How far each sample is to be trusted, >= 0, [..., V, U, 1, H, W].

    Returns:
        Bool, of the same shape.
    """
    return weight > LEAST * weight.amax((-5, -4, -3, -2, -1), keepdim=True)


def extended(views: Tensor, is_trusted: Tensor) -> Tensor:
    """Views that go on smoothly as what is around, where none is trusted: blurs then mix in no black.

    Args:
        views: As `filled` leaves them, [..., V, U, C, H, W].
        is_trusted: As `trusted` says, [..., V, U, 1, H, W].

    Returns:
        The views; pixels at which none is trusted made of the mean of the views around them.
    """
    known = is_trusted.any(-5).any(-4)
    y, x = (~known).flatten(0, -3).any(0).nonzero(as_tuple=True)
    if len(y) == 0:
        return views
    mean = views.mean((-5, -4))
    around = _around(*(each.reshape(-1, *each.shape[-3:]) for each in (mean, known.to(views)))).reshape(mean.shape)
    made, is_known = views.clone(), known[..., None, None, :, :, :]
    made[..., y, x] = torch.where(is_known[..., y, x], views[..., y, x], around[..., None, None, :, :, :][..., y, x])
    return made


def _around(image: Tensor, known: Tensor) -> Tensor:
    """Images [B, C, H, W] whose unknown pixels are those of half the size, where each knows of four; [B, 1, H, W]."""
    if min(image.shape[-2:]) == 1 or bool((known > 0).all()):
        return image
    share = F.avg_pool2d(known, 2, ceil_mode=True)
    coarse = F.avg_pool2d(image * known, 2, ceil_mode=True) / share.clamp(min=torch.finfo(share.dtype).tiny)
    coarse = _around(coarse, (share > 0).to(share))
    return torch.where(known > 0, image, F.interpolate(coarse, image.shape[-2:], mode="bilinear", align_corners=False))


def foretold(views: Tensor, weights: Tensor) -> Tensor:
    """Views of which those that are missing are what disparity layers of the others show from there.

    Args:
        views: Floating point, [..., V, U, C, H, W].
        weights: Of each view, 0 where it is missing, at least one above, [V, U].
    """
    layers, whole = disparity_layers(views, weights=weights), views.clone()
    for v, u in (weights == 0).nonzero().tolist():
        whole[..., v, u, :, :, :] = layers.view(v, u)
    return whole


def of_whole_views(weight: Tensor) -> Tensor | None:
    """The weight of each view, [V, U], where it is the same at all of its pixels; None where it is not.

    Args:
        weight: Of each sample, the same for all light fields, [..., V, U, 1, H, W].
    """
    flat = weight.reshape(-1, *weight.shape[-5:])
    first = flat[:1, ..., :1, :1]
    return first[0, :, :, 0, 0, 0] if bool((flat == first).all()) else None
