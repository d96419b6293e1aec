"""How bright every view is beside the central one, window by window, where both show the same part of the scene.

The views are reduced, and read where the disparity of the central view says that they show what it shows. Clipped
samples say nothing of light, and what reaches beyond a view is not known there.
Letters: `V U` view rows and columns, `C` channels, `n` windows; `y x` places in half diagonals from a view's centre.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.functional import threads
from lfref.functional.jit import compiled
from lfref.lightfield import LightField

# PART block_means
# Pictures reduced to the means of their blocks, in one pass; blocks that hold clipped samples are told.
#
# Letters: `f` pixels along a block's side.

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


REDUCTION = 4  # pixels: brightness changes slowly, and disparities of a pixel become a fraction of one
WINDOWS = 24  # along the longer side
SMALLEST = 3  # reduced pixels along a window's side
CLIPPED = 0.98  # of the brightest sample, or of 1
DARKEST = 0.03  # of the mean light of the central view: below, ratios are noise
LEAST_RATIO = 0.02  # logarithms are of no less


class Ratios(NamedTuple):
    """What each window of the central view has become in each view."""

    log: Tensor
    """Logarithm of the brightness over that of the central view, 0 where not known, [V, U, C, n]."""
    known: Tensor
    """Whether it is, [V, U, n]."""
    places: Tensor
    """Where the window lies in each view, rows and columns, [2, V, U, n]."""
    views: Tensor
    """Place of each view in view steps from the angular centre, rows and columns, [2, V, U, 1]."""
    shape: tuple[int, int]
    """Rows and columns of windows, of which there are n."""
    centre: tuple[int, int]
    """Row and column of the view that all are compared with."""


@torch.no_grad()
def ratios(field: LightField, disparity: Tensor, centre: tuple[int, int]) -> Ratios:
    """Compare all views with the central one.

    Args:
        field: The light field.
        disparity: Of each pixel of the central view, in pixels per view step, [H, W].
        centre: Row and column of that view.
    """
    height, width = field.size
    factor = max(1, min(REDUCTION, min(height, width) // 8))
    images = field.views.flatten(0, 1)
    reduced = block_means(images, factor, _clipping(images))
    disparity = block_means(disparity[None, None].to(reduced), factor, torch.tensor([math.inf]))[0, 0] / factor
    views = view_places(field).to(reduced)
    rows, columns = _where(disparity, views - views[:, centre[0], centre[1], None, None])
    warped = _read(reduced, rows, columns).unflatten(0, field.grid)
    side = max(SMALLEST, round(max(disparity.shape) / WINDOWS))
    light = _windows(warped, side)
    central = light[centre]
    ratio = light / central
    bright = central > DARKEST * central.nanmean()
    known = (ratio.isfinite() & bright).all(2) & _lit(field)[..., None].to(bright.device)
    log = torch.where(known[:, :, None], ratio, 1.0).clamp(min=LEAST_RATIO).log()
    half_diagonal = math.hypot(height, width) / 2
    places = [
        ((_windows(place[:, :, None], side)[:, :, 0] + 0.5) * factor - length / 2) / half_diagonal
        for place, length in ((rows, height), (columns, width))
    ]
    shape = (disparity.shape[0] // side, disparity.shape[1] // side)
    return Ratios(log, known, torch.stack(places), views[..., None], shape, centre)


def view_places(field: LightField) -> Tensor:
    """Rows and columns of all views in view steps from the angular centre, float64, [2, V, U]."""
    positions = getattr(field, "positions", None)
    if positions is not None:
        return positions.movedim(-1, 0)
    return torch.stack(torch.meshgrid(*map(geometry.angular_offsets, field.grid), indexing="ij"))


def _lit(field: LightField) -> Tensor:
    """Views that are to be trusted anywhere, [V, U]."""
    if field.weight is None:
        return torch.ones(field.grid, dtype=torch.bool)
    return field.weight[..., ::4, ::4].flatten(2).amax(2).cpu() > 0


def _clipping(images: Tensor) -> Tensor:
    """Value of each channel from which on samples count as clipped, by some of their rows and columns, [C]."""
    # At 1 or, after white balance, above: what is white in a darker picture is not clipped.
    return CLIPPED * images[..., ::8, ::4].amax((0, 2, 3)).clamp(min=1)


def _where(disparity: Tensor, views: Tensor) -> tuple[Tensor, Tensor]:
    """Row and column at which each view shows each reduced pixel of the central one, [V, U, h, w] each."""
    own = [torch.arange(length).to(disparity) for length in disparity.shape]
    v, u = views[..., None, None]
    return own[0][:, None] + v * disparity, own[1] + u * disparity


def _read(images: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Pictures [VU, C, h, w] between their pixels; NaN beyond the outermost."""
    height, width = images.shape[-2:]
    y, x = (2 * rows + 1) / height - 1, (2 * columns + 1) / width - 1
    places = torch.stack([x, y], -1).flatten(0, 1)
    outside = (rows < 0) | (rows > height - 1) | (columns < 0) | (columns > width - 1)
    read = F.grid_sample(images, places, padding_mode="border", align_corners=False)
    return read.masked_fill_(outside.flatten(0, 1)[:, None], torch.nan)


def _windows(maps: Tensor, side: int) -> Tensor:
    """Means of windows, [V, U, C, n]."""
    return F.avg_pool2d(maps.flatten(0, 1), side).flatten(2).unflatten(0, maps.shape[:2])
