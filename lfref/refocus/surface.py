"""Focus on a surface: a slope for every pixel, and its affine case, the tilted plane of a view camera.

`I(x, y) = sum_uv w_uv L[v, u](x + s(x, y) (u - u0), y + s(x, y) (v - v0)) / sum_uv w_uv`, over views that have a
sample there; differentiable in the views and in the slopes.
Letters: `u v` view column and row, `x y` pixel column and row, `s` slope in pixels per view step.
Source of `tilt_shift`: Vaish et al., "Synthetic aperture focusing using a shear-warp factorization of the viewing
transform", 2005.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.geometry import Slopes
from lfref.refocus import batches
from lfref.refocus.gather import ViewMap, mean_of_views


def per_pixel(
    views: Tensor,
    slope_map: Tensor,
    interpolation: str = "linear",
    border: str = "renormalize",
    weights: Tensor | None = None,
    positions: Tensor | None = None,
) -> Tensor:
    """Refocus light fields on surfaces, each pixel at its own slope.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slope_map: Focus in pixels per view step, [H, W] or [N, H, W].
        interpolation: `nearest`, `linear` or `cubic`.
        border: `renormalize` (only views with a sample there count), `edge`, `zero` or `wrap`.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Returns:
        Stacks in the order of the maps (N = 1 for a single one), type (float32 for integers) and device of the views,
        [..., N, C, H, W]. A pixel that no weighted view covers is 0.

    Raises:
        InputError: Views, slopes, weights, positions or names that cannot be used.

    Example:
        >>> views, slope_map = torch.rand(5, 5, 3, 48, 64), torch.full((48, 64), 0.25)
        >>> torch.allclose(lfref.per_pixel(views, slope_map), lfref.shift_and_sum(views, [0.25]), atol=1e-6)
        True
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    slopes = torch.as_tensor(slope_map, dtype=torch.float64, device=batch.device)
    if slopes.ndim not in (2, 3) or tuple(slopes.shape[-2:]) != size or slopes.numel() == 0:
        raise InputError(
            f"a slope map must be {list(size)} or [N, {size[0]}, {size[1]}], one slope for each pixel",
            got=f"shape {list(slopes.shape)}",
            remedy="resize the map to the views",
        )
    batches.checked_slopes(torch.stack(slopes.detach().aminmax()), grid, size, positions)
    slopes = slopes.reshape(-1, *size)
    cameras = None if positions is None else batches.checked_positions(positions, grid)
    planes = [ViewMap(slopes=plane, positions=cameras) for plane in slopes]
    stack = mean_of_views(batch, batches.checked_weights(weights, grid), planes, interpolation, border)
    return batches.restored(stack, views)


def tilt_shift(
    views: Tensor,
    slope: Slopes | float,
    tilt: Tensor | Sequence[float],
    interpolation: str = "linear",
    border: str = "renormalize",
    weights: Tensor | None = None,
    positions: Tensor | None = None,
) -> Tensor:
    """Refocus light fields on slanted planes: s(x, y) = slope + a x + b y, with x and y counted from pixel 0.

    Args:
        views: As in `per_pixel`, as are all arguments but the next two.
        slope: Focus at the top left pixel, in pixels per view step, [N] or one number.
        tilt: Change of slope (a, b) per pixel to the right and per pixel downwards.
        interpolation: `nearest`, `linear` or `cubic`.
        border: `renormalize`, `edge`, `zero` or `wrap`.
        weights: Synthetic aperture.
        positions: Of the cameras.

    Returns:
        Stacks in the order of the slopes, otherwise as `per_pixel`, [..., N, C, H, W].

    Raises:
        InputError: As `per_pixel`, or a tilt that is not two numbers.

    Example:
        >>> views = torch.rand(5, 5, 3, 48, 64)
        >>> lfref.tilt_shift(views, slope=-0.5, tilt=[0.0, 0.02]).shape  # one slope more every 50 rows
        torch.Size([1, 3, 48, 64])
    """
    batches.check(views)
    focus = slope if isinstance(slope, Tensor) else geometry.as_slopes(slope)  # a tensor keeps its derivatives
    start = focus.to(views.device, torch.float64).reshape(-1, 1, 1)
    change = torch.as_tensor(tilt, dtype=torch.float64, device=views.device)
    if change.shape != (2,):
        raise InputError("tilt must be two numbers, slope per pixel along x and y", got=f"shape {list(change.shape)}")
    rows, columns = (torch.arange(n, dtype=torch.float64, device=views.device) for n in views.shape[-2:])
    slope_map = start + change[0] * columns + change[1] * rows[:, None]
    return per_pixel(views, slope_map, interpolation, border, weights, positions)
