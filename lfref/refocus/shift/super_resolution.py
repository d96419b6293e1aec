"""Super-resolved refocusing: at a fractional slope the views sample a surface at different places, between each other.

Every sample is put at its refocused position on a grid `r` times finer and weighs by its distance from the fine pixel:
`I(X, Y) = sum k(X/r - x_j) k(Y/r - y_i) w_uv L[v, u][i, j] / sum k(X/r - x_j) k(Y/r - y_i) w_uv`, with
`x_j = j - s (u - u0)` and `y_i = i - s (v - v0)`. Fine pixel X lies at x = X/r, so that coarse pixels lie on the grid.
The fine pixels of one phase X mod r are a shifted coarse image, which makes this r x r shift-and-sums of two taps.
Letters: `u v` view column and row, `x y` pixel column and row, `X Y` fine pixel column and row, `r` factor, `s` slope.
"""

import math

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.geometry import Slopes
from lfref.refocus import batches, borders

HALF_WIDTH = 0.75  # fine pixels to each side: narrower keeps more detail, wider more samples (less noise, no gaps)
FALLBACK = 1e-3  # weight of linear interpolation beside it: decides only where no view has a sample that near
LEAST_WEIGHT = 1e-12  # below this share of the aperture only rounding put a sample near


def super_resolve(views: Tensor, slopes: Slopes, factor: int = 2, weights: Tensor | None = None) -> Tensor:
    """Refocus light fields onto a finer grid; linear in the views.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N]; at whole slopes this is linear interpolation, with no gain.
        factor: Fine pixels per pixel along each axis, r, >= 1.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views,
        [..., N, C, factor * H, factor * W]. A pixel with no weighted sample within one coarse pixel is 0.

    Raises:
        InputError: Views, slopes, factor or weights that cannot be used.

    Example:
        >>> lfref.super_resolve(torch.rand(5, 5, 3, 48, 64), [0.3], factor=2).shape
        torch.Size([1, 3, 96, 128])
    """
    if not (isinstance(factor, int) and factor >= 1):
        raise InputError("factor must be a whole number of at least 1", got=repr(factor))
    batch = batches.flattened(views)
    return batches.restored(_stack(batch, slopes, factor, weights), views)


def _stack(views: Tensor, slopes: Slopes, factor: int, weights: Tensor | None) -> Tensor:
    grid, size = batches.grid_and_size(views)
    planes = geometry.checked_slopes(slopes, grid, size)[:, None]
    aperture = batches.checked_weights(weights, grid)
    views = batches.without_unread(views, aperture)
    rows, columns = ((planes * geometry.angular_offsets(n_views)).tolist() for n_views in grid)
    like = batches.radiance(views[:, 0, 0])
    images = [like.new_zeros(factor, factor, *like.shape) for _ in rows]
    for v, (view_row, row_weights) in enumerate(zip(views.unbind(1), aperture, strict=True)):
        weighted = batches.radiance(view_row) * row_weights.to(like)[:, None, None, None]
        for image, row_shifts, column_shifts in zip(images, rows, columns, strict=True):
            row_sum = like.new_zeros(factor, *like.shape)
            for view, shift in zip(weighted.unbind(1), column_shifts, strict=True):
                _add(row_sum, view, shift, -1)
            _add(image, row_sum, row_shifts[v], -2)
    for image, row_shifts, column_shifts in zip(images, rows, columns, strict=True):
        image.mul_(_inverse_weight(row_shifts, column_shifts, aperture, size, factor).to(image))
    return _interleaved(torch.stack(images))


def _add(total: Tensor, samples: Tensor, shift: float, axis: int) -> None:
    """Add samples, read at x + shift, onto a running sum.

    Args:
        total: Fine pixels by phase, [r, ...], added to in place.
        samples: Along `axis`, -1 or -2, [...].
        shift: In coarse pixels.
        axis: Along which to shift.
    """
    factor, length = total.shape[0], samples.shape[axis]
    for phase in range(factor):
        image, position = total[phase], shift + phase / factor
        for offset in (math.floor(position), math.floor(position) + 1):
            start, stop = borders.sampled_span(offset, length)
            if start < stop:
                taken = samples.narrow(axis, start + offset, stop - start)
                image.narrow(axis, start, stop - start).add_(taken, alpha=_weight(position - offset, factor))


def _weight(distance: float, factor: int) -> float:
    """Weight of a sample at a distance of at most one coarse pixel."""
    return max(0.0, 1 - abs(distance) * factor / HALF_WIDTH) + FALLBACK * (1 - abs(distance))


def _inverse_weight(
    rows: list[float], columns: list[float], aperture: Tensor, size: tuple[int, int], factor: int
) -> Tensor:
    """One over the weight of all samples of each fine pixel, 0 where there is none, [r, r, 1, 1, H, W]."""
    row_weight, column_weight = (_axis_weight(*axis, factor) for axis in ((rows, size[0]), (columns, size[1])))
    weight = torch.einsum("vpy,vu,uqx->pqyx", row_weight, aperture, column_weight)[:, :, None, None]
    return torch.where(weight > LEAST_WEIGHT, 1 / weight, 0.0)


def _axis_weight(shifts: list[float], length: int, factor: int) -> Tensor:
    """Weight of each view's samples along one axis, float64, [len(shifts), r, length]."""
    total = torch.zeros(len(shifts), factor, length, dtype=torch.float64)
    for view, shift in zip(total, shifts, strict=True):
        _add(view, torch.ones(length, dtype=torch.float64), shift, -1)
    return total


def _interleaved(images: Tensor) -> Tensor:
    """Fine pixels by phase, [N, r, r, B, C, H, W], put side by side, [B, N, C, r H, r W]."""
    n_planes, factor, _, n_batches, channels, height, width = images.shape
    side_by_side = images.permute(3, 0, 4, 5, 1, 6, 2)
    return side_by_side.reshape(n_batches, n_planes, channels, factor * height, factor * width)
