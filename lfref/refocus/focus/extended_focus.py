"""A picture that is sharp everywhere: at each pixel the mean of the views that show the same point.

Views are read at the disparity of each pixel. Those that show something else there, because a nearer surface hides the
point from them, do not count: edges stay clean, and there are as few copies at borders as within. All others average
their noise out, which is what the picture has over the central view.
"""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.functional import splines, threads
from lfref.refocus import batches
from lfref.refocus.focus.disparity import disparity_map
from lfref.refocus.matching import agreement, grey, mean_loop
from lfref.refocus.matching.grey import GreyViews

WORTH_A_THREAD = 1 << 10
"""Pixels from which one more thread saves more than it costs."""


@torch.no_grad()
def extended_focus(
    views: Tensor, disparity: Tensor | None = None, weights: Tensor | None = None, positions: Tensor | None = None
) -> Tensor:
    """Make the picture of the central view with the light of all of them, on the CPU.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W], more than one view.
        disparity: Of each pixel of the central view, in pixels per view step, [..., H, W]; None has it found.
        weights: Which views to look at: those of weight 0 are not, [V, U]; None looks at all.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Returns:
        Sharp pictures in the type (float32 for integers) and on the device of the views, [..., C, H, W]. No gradients.

    Raises:
        InputError: Views, a map, weights or positions that cannot be used.

    Example:
        >>> views = torch.rand(5, 5, 3, 48, 64)
        >>> lfref.extended_focus(views).shape
        torch.Size([3, 48, 64])
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    aperture = batches.checked_weights(weights, grid)
    maps = disparity_map(views, weights=weights, positions=positions).disparity if disparity is None else disparity
    _check(maps, (*views.shape[:-5], *size))
    maps = maps.detach().float().cpu().reshape(-1, *size)
    pictures = [_picture(field, aperture, positions, map_) for field, map_ in zip(batch, maps, strict=True)]
    made = torch.stack(pictures).reshape(*views.shape[:-5], *views.shape[-3:])
    return made.to(views.device, batches.stack_dtype(views))


def _check(disparity: Tensor, shape: tuple[int, ...]) -> None:
    if tuple(disparity.shape) != shape:
        raise InputError(f"disparity must be {list(shape)}, a number a pixel", got=f"shape {list(disparity.shape)}")
    if not bool(disparity.isfinite().all()):
        raise InputError("disparity must be finite", got="NaN or infinity", remedy="fill what is missing first")


def _picture(views: Tensor, aperture: Tensor, positions: Tensor | None, disparity: Tensor) -> Tensor:
    """One light field [V, U, C, H, W] as one picture [C, H, W]."""
    light = grey.grey_views(views, aperture, positions)
    places, weights = disparity.numpy(), _weights(light, disparity)
    read = views.detach()[(aperture > 0).to(views.device)]
    channels = [
        _mean(batches.radiance(channel).float().cpu().contiguous(), light, places, weights)
        for channel in read.unbind(1)
    ]
    return torch.stack(channels)


def _weights(light: GreyViews, disparity: Tensor) -> np.ndarray:
    """How far each view shows the point at each pixel, [H, W, K]."""
    noise = agreement.noise(light, torch.linspace(float(disparity.min()), float(disparity.max()), 9))
    spread, coefficients = agreement.spread(light, noise).numpy(), splines.coefficients(light.samples)
    weights, places = np.empty((*disparity.shape, len(light.samples)), np.float32), disparity.numpy()

    def weigh(top: int, end: int) -> None:
        part = weights[top:end]
        mean_loop.weigh_views(coefficients, light.places, light.middle, places, spread, top, part)

    _in_bands(weigh, disparity.shape)
    return weights


def _mean(channel: Tensor, light: GreyViews, disparity: np.ndarray, weights: np.ndarray) -> Tensor:
    """One channel of the views, [K, H, W], as one of the picture, [H, W]."""
    coefficients, picture = splines.coefficients(channel.numpy()), np.empty_like(disparity)

    def add(top: int, end: int) -> None:
        mean_loop.add_views(coefficients, light.places, disparity, weights[top:end], top, picture[top:end])

    _in_bands(add, disparity.shape)
    return torch.from_numpy(picture)


def _in_bands(work: Callable[[int, int], None], size: Sequence[int]) -> None:
    n_threads = threads.worthwhile(size[0] * size[1], WORTH_A_THREAD)
    threads.share(work, threads.bands(size[0], n_threads), n_threads)
