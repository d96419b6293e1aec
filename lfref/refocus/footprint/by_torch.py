"""Planes blurred by boxes, by plain PyTorch operations: on any device, and differentiable.

Beyond its edge a plane is what the border rule makes of it. Where only samples count it is black there, and so is its
coverage: the blurred sum over the blurred coverage is the mean of what there is.
"""

import torch
from torch import Tensor

from lfref.refocus.borders import BORDERS, Border
from lfref.refocus.footprint import box, levels

LEAST_SHARE = 0.125
"""Share of its own coverage that a pixel must find around it: the taps of a box sum up to nothing in odd places."""


def boxed(images: Tensor, width: float, border: Border) -> Tensor:
    """Images blurred by a box along both axes.

    Args:
        images: Floating point, [..., H, W].
        width: Of the box in pixels, >= 0.
        border: How they continue; black where only samples count.
    """
    return boxed_along(boxed_along(images, width, border, -1), width, border, -2)


def boxed_along(images: Tensor, width: float, border: Border, axis: int) -> Tensor:
    """The same along one axis, -1 (columns) or -2 (rows)."""
    weights, length = box.taps(width), images.shape[axis]
    if len(weights) == 1:
        return images
    extended = _extended(images, len(weights) // 2, axis, border)
    total = extended.narrow(axis, 0, length) * weights[0]
    for k, weight in enumerate(weights[1:], start=1):
        total = total.add(extended.narrow(axis, k, length), alpha=weight)
    return total


def blurred(stack: Tensor, places: Tensor, border: Border, covered: Tensor | None) -> Tensor:
    """Planes blurred by a box of another width at every pixel, over the weight of the samples that count.

    Args:
        stack: [B, N, C, H, W].
        places: Of the widths among the `levels`, [B or 1, N, H, W].
        border: As of `boxed`.
        covered: Share of the aperture that has a sample, in the type of the stack, [N, H, W]; None: all of it.
    """
    planes = []
    for n, own in enumerate(places.unbind(1)):
        if covered is None:
            planes.append(blended(stack[:, n], own, border))
        else:
            weight = blended(covered[n].expand(len(own), 1, -1, -1), own, border)
            planes.append(blended(stack[:, n] * covered[n], own, border) * inverse(covered[n], weight))
    return torch.stack(planes, dim=1)


def blended(planes: Tensor, places: Tensor, border: Border) -> Tensor:
    """Images blurred by a box of another width at every pixel.

    Args:
        planes: Floating point, [B, C, H, W].
        places: Of the widths among the `levels`, [B or 1, H, W].
        border: As of `boxed`.
    """
    total = torch.zeros_like(planes)
    for level in levels.spanned(places):
        share = (1 - (places - level).abs()).clamp(min=0)[:, None]
        total = total + share.to(planes) * boxed(planes, levels.width(level), border)
    return total


def inverse(coverage: Tensor, blurred: Tensor) -> Tensor:
    """One over the blurred coverage; 0 where a pixel is not covered, or nearly nothing around it is.

    Args:
        coverage: Share of the aperture that has a sample at each pixel, >= 0, any shape.
        blurred: The same, blurred as the plane is.
    """
    counts = (coverage > 0) & (blurred > LEAST_SHARE * coverage)
    return torch.where(counts, 1 / torch.where(counts, blurred, 1.0), 0.0)


def _extended(images: Tensor, pad: int, axis: int, border: Border) -> Tensor:
    """The images with `pad` more samples at both ends of an axis, which may be more than they have."""
    length = images.shape[axis]
    if border.counts_only_samples:
        border = BORDERS["zero"]
    places = torch.arange(-pad, length + pad, device=images.device)
    index, weight = border.tap(places, torch.ones_like(places), length)
    extended = images.index_select(axis, index)
    if bool(weight.all()):
        return extended
    return extended.masked_fill((weight == 0)[(...,) + (None,) * (-1 - axis)], 0)
