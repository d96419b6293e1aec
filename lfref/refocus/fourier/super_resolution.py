"""Super-resolved refocusing: where views agree, they sample one surface between each other's pixels.

What is in focus is the picture on a finer grid that all views are samples of (`finer_grid`). Elsewhere there is no such
picture, and the plane of exact Fourier refocusing, brought to the finer grid without a change, is the better one. Which
it is, the views say: both pictures foretell them, and the finer one is taken where it errs much less.
Letters: `v u` view row and column, `r` factor, `s` slope in pixels per view step.
"""

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.geometry import Slopes
from lfref.refocus import batches
from lfref.refocus.fourier import finer_grid
from lfref.refocus.fourier.exact import exact_fourier

RADIUS = 4
"""Pixels around a pixel whose errors are compared."""
SURE, UNSURE = 0.2, 0.6
"""Share of the plane's squared error that is left to the finer picture: below all of it is taken, above nothing."""
LEAST_ERROR = 1e-7
"""Squared error, of views whose brightest pixel is 1, below which there is nothing to choose by."""


def super_resolve(views: Tensor, slopes: Slopes, factor: int = 2, weights: Tensor | None = None) -> Tensor:
    """Refocus light fields onto a finer grid: more detail where they are in focus, `exact_fourier` elsewhere.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, taken as periodic, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N]; at whole slopes views tell no more than one of them.
        factor: Fine pixels per pixel along each axis, r, >= 1.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views, fine pixel X at
        x = (X + 1/2) / r - 1/2, [..., N, C, r H, r W].

    Raises:
        InputError: Views, slopes, factor or weights that cannot be used.

    Example:
        >>> lfref.super_resolve(torch.rand(5, 5, 3, 48, 64), [0.3], factor=2).shape
        torch.Size([1, 3, 96, 128])
    """
    finer_grid.check_factor(factor)
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    planes, aperture = geometry.checked_slopes(slopes, grid, size), batches.checked_weights(weights, grid)
    batch = batches.without_unread(batch, aperture)
    if batch.is_floating_point():
        batch = batch.to(batches.working_dtype(batch.dtype))  # half types are rounded once, at the end
    stack = finer_grid.band_limited(exact_fourier(batch, planes, aperture), factor)
    grey = torch.stack([batches.radiance(row).mean(2) for row in batch.unbind(1)], 1)
    brightest = grey.detach().abs().amax((1, 2, 3, 4)).clamp(min=torch.finfo(grey.dtype).tiny)[:, None, None]
    grey = grey / brightest[..., None, None]
    made = []
    finer_pictures = finer_grid.pictures(batch, planes, factor, aperture)
    for slope, plane, fine in zip(planes.tolist(), stack.unbind(1), finer_pictures, strict=True):
        errors = [_errors(grey, each.mean(1) / brightest, slope, aperture, factor) for each in (fine, plane)]
        made.append(torch.lerp(plane, fine, _enlarged(_trust(*errors), factor)))
    return batches.restored(torch.stack(made, 1), views)


def _errors(views: Tensor, picture: Tensor, slope: float, aperture: Tensor, factor: int) -> Tensor:
    """Mean squared error of a picture that foretells views, where they show its pixels and around.

    Args:
        views: In grey, the brightest pixel 1, [B, V, U, H, W].
        picture: Likewise, [B, r H, r W].
        slope: Of the picture.
        aperture: Weight of each view, together 1, [V, U].
        factor: r.

    Returns:
        [B, 1, H, W].
    """
    grid = (views.shape[1], views.shape[2])
    squares = (views - finer_grid.seen(picture, slope, factor, grid)).square() * aperture.to(views)[:, :, None, None]
    down, across = ((-slope * geometry.angular_offsets(n)).round().long().tolist() for n in grid)
    # Each view's errors go back to where the picture has what they are about.
    total = torch.zeros_like(squares[:, 0, 0])
    for v, y in enumerate(down):
        for u, x in enumerate(across):
            total = total + squares[:, v, u].roll((y, x), (-2, -1))
    around = F.pad(total[:, None], (RADIUS,) * 4, mode="replicate")
    return F.avg_pool2d(around, 2 * RADIUS + 1, 1) + LEAST_ERROR


def _trust(of_fine: Tensor, of_plane: Tensor) -> Tensor:
    """How far the finer picture is taken, from 0 to 1, of the errors of both."""
    return ((UNSURE - of_fine / of_plane) / (UNSURE - SURE)).clamp(0, 1)


def _enlarged(share: Tensor, factor: int) -> Tensor:
    """A map [B, 1, H, W] for fine pixels, [B, 1, r H, r W]."""
    return F.interpolate(share, scale_factor=factor, mode="bilinear")
