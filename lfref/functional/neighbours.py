"""Filters over neighbouring pixels: box means and maxima, and Gaussian means.

On a processor, boxes are computed by shifting whole pictures against each other, one axis after the other. This takes a
fraction of the time of PyTorch's pooling, which reads each window anew.
"""

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.functional.devices import is_known

LARGE = 15
"""Side of a square, in pixels, from which on pooling a row, then a column, takes fewer operations than shifts."""


def box_mean(images: Tensor, window: int) -> Tensor:
    """Mean of a square of `window` (odd) pixels about each pixel of images [..., H, W]; it ends at their border."""
    if window > LARGE or not is_known(images):
        flat = images.reshape(1, -1, *images.shape[-2:])
        for sides in ((window, 1), (1, window)):
            reach = (sides[0] // 2, sides[1] // 2)
            flat = F.avg_pool2d(flat, sides, 1, reach, count_include_pad=False)
        return flat.reshape(images.shape)
    for axis in (-2, -1):
        sums, counts = images.clone(), images.new_ones(images.shape[axis])
        ones = counts.clone()
        for apart in range(1, window // 2 + 1):
            _add(sums, images, apart, axis)
            _add(counts, ones, apart, -1)
        images = sums / (counts if axis == -1 else counts[:, None])
    return images


def box_max(images: Tensor, window: int) -> Tensor:
    """Largest value of a square of `window` (odd) pixels about each pixel of images [..., H, W]."""
    reach = window // 2
    for axis, beyond in ((-2, (0, 0, reach, reach)), (-1, (reach, reach))):
        images, span = F.pad(images, beyond, value=torch.finfo(images.dtype).min), 1
        # Each pass doubles the number of pixels under the maximum.
        while span < window:
            apart = min(span, window - span)
            length = images.shape[axis] - apart
            images = torch.maximum(images.narrow(axis, 0, length), images.narrow(axis, apart, length))
            span += apart
    return images


def _add(sums: Tensor, images: Tensor, apart: int, axis: int) -> None:
    """Add to each pixel, in place, its two neighbours at a distance of `apart` along an axis, where they exist."""
    length = images.shape[axis] - apart
    if length > 0:
        sums.narrow(axis, apart, length).add_(images.narrow(axis, 0, length))
        sums.narrow(axis, 0, length).add_(images.narrow(axis, apart, length))


def gradient(images: Tensor, axis: int) -> Tensor:
    """Central differences along an axis of at least 2 pixels; those at its ends are one-sided."""
    length = images.shape[axis]
    inner = (images.narrow(axis, 2, length - 2) - images.narrow(axis, 0, length - 2)) / 2
    first, last = (images.narrow(axis, at + 1, 1) - images.narrow(axis, at, 1) for at in (0, length - 2))
    return torch.cat([first, inner, last], axis)


def smoothed(images: Tensor, sigma: float) -> Tensor:
    """Local means of images [B, H, W] under a Gaussian of `sigma` pixels; edge pixels repeat beyond the edge."""
    if sigma == 0:
        return images
    half_width = math.ceil(3 * sigma)
    offsets = torch.arange(-half_width, half_width + 1, dtype=torch.float64, device=images.device)
    window = (-(offsets / sigma).square() / 2).softmax(0).to(images.dtype)
    padded = F.pad(images, (half_width,) * 4, mode="replicate")
    if torch.compiler.is_exporting():  # a file has a fixed number of channels
        rows = F.conv2d(padded[:, None], window.expand(1, 1, 1, -1))
        return F.conv2d(rows, window[:, None].expand(1, 1, -1, 1))[:, 0]
    with torch.autocast(images.device.type, enabled=False):
        # Images as channels: CUDA never runs a depthwise convolution in TF32.
        rows = F.conv2d(padded[None], window.expand(len(images), 1, 1, -1), groups=len(images))
        return F.conv2d(rows, window[:, None].expand(len(images), 1, -1, 1), groups=len(images))[0]
