"""Replacing untrusted samples, for methods that compare the views instead of summing them.

A sum leaves such samples out by their weight, but black or weighted samples would mislead estimates of disparity or of
layers. On the `vignetting` scene of sim30, divided by its gain, occlusion-aware refocusing reaches 47.7 dB against the
truth with weighted views and 54.9 dB with filled ones. On `discs` without its four corner views it reaches 35.8 dB, and
57.8 dB if they are predicted (59.4 dB with all views).
Letters: `V U` view rows and columns, `C H W` channel, pixel row and column.
"""

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.refocus import batches
from lfref.refocus.fourier.disparity_layers import disparity_layers

LEAST = 0.05
"""Share of a light field's largest weight below which samples are untrusted."""
TRUSTED = 0.1
"""Share of the largest weight at a pixel below which samples are replaced, lighter ones more."""

AT_ONCE = 2**21
"""Samples of all views at the pixels that are filled at once, 8 MB."""


def filled(views: Tensor, weight: Tensor) -> Tensor:
    """Replace samples of little weight [..., V, U, 1, H, W] by the weighted mean of all views at that pixel.

    Samples below `TRUSTED` fade to that mean, which is black where no view has any weight.
    """
    # Samples of less weight are filled.
    least = TRUSTED * weight.amax((-5, -4), keepdim=True)
    # Only pixels that have such a sample are computed.
    is_short = torch.stack([(row < least[..., 0, :, :, :, :]).flatten(0, -3).any(0) for row in weight.unbind(-5)])
    y, x = (is_short.any(0) | (least == 0).flatten(0, -3).any(0)).nonzero(as_tuple=True)
    if len(y) == 0:
        return views
    result, tiny = views.clone(), torch.finfo(weight.dtype).tiny
    # Some pixels at a time, since several copies of their samples are needed.
    n_at_once = max(1, AT_ONCE // (views.numel() // math.prod(views.shape[-2:])))
    for rows, columns in zip(y.split(n_at_once), x.split(n_at_once), strict=True):
        trust, limit = weight[..., rows, columns], least[..., rows, columns]
        samples = torch.where(trust > 0, views[..., rows, columns], 0)  # what has no weight may even be NaN
        mean = (samples * trust).sum((-4, -3), keepdim=True) / trust.sum((-4, -3), keepdim=True).clamp(min=tiny)
        share = (trust / limit.clamp(min=tiny)).clamp(max=1)
        result[..., rows, columns] = torch.lerp(mean.expand_as(samples), samples, share)
    return result


def readable(views: Tensor, weight: Tensor) -> Tensor:
    """The views, black where a sample has weight 0 and is not finite: 0 times NaN is NaN."""
    if not views.is_floating_point() or batches.is_finite(views):
        return views
    return torch.where((weight == 0) & ~views.isfinite(), 0, views)


def trusted(weight: Tensor) -> Tensor:
    """Which samples have weight beyond `LEAST`: interpolated weights are seldom exactly 0."""
    return weight > LEAST * weight.amax((-5, -4, -3, -2, -1), keepdim=True)


def extended(views: Tensor, is_trusted: Tensor, in_place: bool = False) -> Tensor:
    """Continue `filled` views smoothly over pixels where none is `trusted`, so that blurs mix in no black."""
    known = is_trusted.any(-5).any(-4)
    y, x = (~known).flatten(0, -3).any(0).nonzero(as_tuple=True)
    if len(y) == 0:
        return views
    mean = views.mean((-5, -4))
    around = continued(*(images.reshape(-1, *images.shape[-3:]) for images in (mean, known.to(views))))
    around, is_known = around.reshape(mean.shape)[..., None, None, :, :, :], known[..., None, None, :, :, :]
    result = views if in_place else views.clone()
    result[..., y, x] = torch.where(is_known[..., y, x], views[..., y, x], around[..., y, x])
    return result


def continued(images: Tensor, known: Tensor) -> Tensor:
    """Images [B, C, H, W] whose unknown pixels, 0 in [B, 1, H, W], are taken from the means of ever larger squares."""
    if min(images.shape[-2:]) == 1 or bool((known > 0).all()):
        return images
    share = F.avg_pool2d(known, 2, ceil_mode=True)
    coarse = F.avg_pool2d(images * known, 2, ceil_mode=True) / share.clamp(min=torch.finfo(share.dtype).tiny)
    coarse = continued(coarse, (share > 0).to(share))
    return torch.where(known > 0, images, F.interpolate(coarse, images.shape[-2:], mode="bilinear"))


def predicted(views: Tensor, weights: Tensor, in_place: bool = False) -> Tensor:
    """Replace views of weight 0, [V, U], by those that disparity layers of the other views predict."""
    layers, whole = disparity_layers(views, weights=weights), views if in_place else views.clone()
    for v, u in (weights == 0).nonzero().tolist():
        whole[..., v, u, :, :, :] = layers.view(v, u)
    return whole


def view_weights(weight: Tensor) -> Tensor | None:
    """The weight of each view, [V, U], if it is equal at all its pixels and in all fields; otherwise None."""
    flat = weight.reshape(-1, *weight.shape[-5:])
    first = flat[:1, ..., :1, :1]
    return first[0, :, :, 0, 0, 0] if bool((flat == first).all()) else None
