"""A picture that is sharp everywhere: at each pixel the mean of the views that show the same point.

Views are read at the disparity of each pixel, `L[v, u](x + d u, y + d v)`, and weighed by how well they agree with
their robust mean (`cost_volume.robust_mean`): views from which a nearer surface hides the point do not count, so that
edges stay clean and there are as few copies at borders as within. The others average their noise out, which is what the
picture has over the central view. Weights are computed once, in grey, and serve all channels.
Letters: `k` view, `K` views that are read, `v u` their row and column from the angular centre, `y x` pixel row and
column, `p q` position in a view along y and x, `d` disparity in pixels per view step.
"""

import numpy as np
import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.functional import loops, splines
from lfref.functional.loops import compiled
from lfref.refocus import batches
from lfref.refocus.disparity import cost_volume
from lfref.refocus.disparity.cost_volume import Integers, Reals, mean_of, read_spline, robust_mean
from lfref.refocus.disparity.disparity_map import disparity_map


@torch.no_grad()
def extended_focus(
    views: Tensor, disparity: Tensor | None = None, weights: Tensor | None = None, positions: Tensor | None = None
) -> Tensor:
    """Make the picture of the central view with the light of all of them, on the CPU.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W], more than one view.
        disparity: Of each pixel of the central view, in pixels per view step, [..., H, W]; None estimates it.
        weights: Weight of each view, those of 0 are not read, [V, U]; None reads all.
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
    shape = (*views.shape[:-5], *size)
    if tuple(maps.shape) != shape:
        raise InputError(f"disparity must be {list(shape)}, a number a pixel", got=f"shape {list(maps.shape)}")
    if not bool(maps.isfinite().all()):
        raise InputError("disparity must be finite", got="NaN or infinity", remedy="fill what is missing first")
    maps = maps.detach().float().cpu().reshape(-1, *size)
    pictures = [_picture(field, aperture, positions, map_) for field, map_ in zip(batch, maps, strict=True)]
    return torch.stack(pictures).reshape(*shape[:-2], *views.shape[-3:]).to(views.device, batches.stack_dtype(views))


def _picture(views: Tensor, aperture: Tensor, positions: Tensor | None, disparity: Tensor) -> Tensor:
    """One light field [V, U, C, H, W] as one picture [C, H, W]."""
    light, d = cost_volume.grey_views(views, aperture, positions), disparity.numpy()
    noise = cost_volume.noise(light, torch.linspace(float(disparity.min()), float(disparity.max()), 9))
    spread, coefficients = cost_volume.spread(light, noise).numpy(), splines.coefficients(light.samples)
    weights = np.empty((*disparity.shape, len(light.samples)), np.float32)
    n_threads = loops.worthwhile(disparity.numel(), 1 << 10)  # pixels from which one more thread pays
    bands = loops.bands(len(disparity), n_threads)

    def weigh(first: int, last: int) -> None:
        weigh_views(coefficients, light.positions, light.middle, d, spread, first, weights[first:last])

    loops.share(weigh, bands, n_threads)
    channels = []
    for channel in views.detach()[(aperture > 0).to(views.device)].unbind(1):
        samples = splines.coefficients(batches.radiance(channel).float().cpu().contiguous().numpy())
        picture = np.empty_like(d)
        jobs = [(samples, light.positions, d, weights[a:b], a, picture[a:b]) for a, b in bands]
        loops.share(add_views, jobs, n_threads)
        channels.append(torch.from_numpy(picture))
    return torch.stack(channels)


@compiled
def weigh_views(
    coefficients: Reals, positions: Reals, middle: Integers, disparity: Reals, spread: Reals, top: int, weights: Reals
) -> None:  # pragma: no cover - compiled
    """Weights [R, W, K] of the views at the pixels of a band of rows that begins at row `top`, each in [0, 1]."""
    n_views, height, width = coefficients.shape
    values = np.empty(n_views, np.float32)
    for i in range(weights.shape[0]):
        y = top + i
        for x in range(width):
            for k in range(n_views):
                p, q = y + disparity[y, x] * positions[k, 0], x + disparity[y, x] * positions[k, 1]
                values[k] = np.nan  # no sample beyond the borders: weight 0
                if 0 <= p <= height - 1 and 0 <= q <= width - 1:
                    values[k] = read_spline(coefficients[k], p, q)[0]
            # Once from the mean of the central views, then from the robust mean: no view is special.
            reference = robust_mean(values, mean_of(values, middle), spread[y, x], weights[i, x])
            robust_mean(values, reference, spread[y, x], weights[i, x])


@compiled
def add_views(
    coefficients: Reals, positions: Reals, disparity: Reals, weights: Reals, top: int, picture: Reals
) -> None:  # pragma: no cover - compiled
    """Weighted mean [R, W] of one channel of the views in a band of rows; 0 where no view has a sample."""
    for i in range(picture.shape[0]):
        y = top + i
        for x in range(picture.shape[1]):
            total, sum_of_weights = np.float32(0), np.float32(0)
            for k in range(len(coefficients)):
                weight = weights[i, x, k]
                if weight > 0:  # which also keeps reads within the view
                    p, q = y + disparity[y, x] * positions[k, 0], x + disparity[y, x] * positions[k, 1]
                    total += weight * read_spline(coefficients[k], p, q)[0]
                    sum_of_weights += weight
            picture[i, x] = total / max(sum_of_weights, np.float32(1e-12))
