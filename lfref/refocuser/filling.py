"""What stands in for samples that are not to be trusted, for methods that look at the views instead of summing them.

A sum leaves such samples out. An estimate that is told of views times their weight, or reads what a missing view holds,
goes wrong: on the `vignetting` scene of sim30, divided by its gain, occlusion-aware refocusing of weighted views has
47.7 dB against truth, of filled ones 54.9; with its four corner views missing `discs` has 35.8 dB, with them foretold
57.8 (59.4 with all views).
Letters: `V U` view rows and columns.
"""

import torch
from torch import Tensor

from lfref.refocus.fourier.disparity_layers import disparity_layers

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
