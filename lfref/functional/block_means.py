"""Pictures reduced to the means of their blocks, in one pass; blocks that hold clipped samples are told.

Letters: `f` pixels along a block's side.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from lfref.functional import threads
from lfref.functional.jit import compiled

WORTH_A_THREAD = 1 << 18
"""Samples from which one more thread saves more than it costs."""


@torch.no_grad()
def block_means(images: Tensor, factor: int, limits: Tensor) -> Tensor:
    """Means of square blocks; rows and columns that fill no block are left out.

    Args:
        images: Floating point, [B, C, H, W].
        factor: Pixels along a block's side, from 1 to H and W.
        limits: Value of each channel from which on samples count as clipped, [C].

    Returns:
        [B, C, H // factor, W // factor]; NaN where a sample of the block is clipped, or none.
    """
    if images.device.type != "cpu" or images.dtype not in (torch.float32, torch.float64):
        is_clipped = F.max_pool2d(images, factor) >= limits.to(images)[:, None, None]
        return F.avg_pool2d(images, factor).masked_fill(is_clipped, torch.nan)
    planes, tops = images.flatten(0, 1).numpy(), limits.to(images.dtype).repeat(len(images)).numpy()
    height, width = (length // factor for length in images.shape[-2:])
    means = np.empty((len(planes), height, width), planes.dtype)
    bands = threads.bands(len(planes), threads.worthwhile(planes.size, WORTH_A_THREAD))
    jobs = [(planes[i:j], factor, tops[i:j], means[i:j]) for i, j in bands]
    threads.share(_reduce, jobs, len(jobs))
    return torch.from_numpy(means).unflatten(0, images.shape[:2])


@compiled
def _reduce(planes: NDArray, factor: int, limits: NDArray, means: NDArray) -> None:
    used = means.shape[2] * factor
    total, largest = np.empty(used, planes.dtype), np.empty(used, planes.dtype)
    for n in range(len(planes)):
        for row in range(means.shape[1]):
            total[:] = planes[n, row * factor, :used]
            largest[:] = total
            for f in range(1, factor):
                line = planes[n, row * factor + f, :used]
                for x in range(used):
                    total[x] += line[x]
                    largest[x] = max(largest[x], line[x])
            for block in range(means.shape[2]):
                light, top = total[block * factor], largest[block * factor]
                for f in range(1, factor):
                    light += total[block * factor + f]
                    top = max(top, largest[block * factor + f])
                means[n, row, block] = light / factor**2 if top < limits[n] else np.nan
