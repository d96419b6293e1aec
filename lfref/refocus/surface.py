"""Focus on a surface: a slope for every pixel, and its affine case, the tilted plane of a view camera.

`I(x, y) = sum_uv w_uv L[v, u](x + s(x, y) (u - u0), y + s(x, y) (v - v0)) / sum_uv w_uv`, over views that have a
sample there; differentiable in the views and in the slopes. Seen through cells of the aperture (see `footprint`), each
pixel is blurred by its own distance from focus.
Letters: `u v` view column and row, `x y` pixel column and row, `s` slope in pixels per view step.
Source of `tilt_shift`: Vaish et al., "Synthetic aperture focusing using a shear-warp factorization of the viewing
transform", 2005.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.geometry import Slopes
from lfref.refocus import batches, footprint, footprint_blur, lines
from lfref.refocus.footprint import Footprint
from lfref.refocus.gather import Places, mean_of_views, pixels
from lfref.refocus.sampling import BORDERS


def per_pixel(
    views: Tensor,
    slope_map: Tensor,
    interpolation: str = "linear",
    border: str = "renormalize",
    weights: Tensor | None = None,
    fill: float = 0.0,
    disparity: float | Tensor = 0.0,
    positions: Tensor | None = None,
) -> Tensor:
    """Refocus light fields on surfaces, each pixel at its own slope.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slope_map: Focus in pixels per view step, [H, W] or [N, H, W].
        interpolation: `nearest`, `linear` or `cubic`.
        border: `renormalize` (only views with a sample there count), `edge`, `zero` or `wrap`.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.
        fill: Side of the cell that each view stands for, in view steps, >= 0: 0 is the sum over points, 1 the integral
            over the aperture.
        disparity: Of what is seen, in pixels per view step: at this slope cells do not blur. A number, a map [H, W], or
            one for each light field, [..., H, W].
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Returns:
        Stacks in the order of the maps (N = 1 for a single one), type (float32 for integers) and device of the views,
        [..., N, C, H, W]. A pixel that no weighted view covers is 0.

    Raises:
        InputError: Views, slopes, weights, cells, positions or names that cannot be used.

    Example:
        >>> views, slope_map = torch.rand(5, 5, 3, 48, 64), torch.full((48, 64), 0.25)
        >>> torch.allclose(lfref.per_pixel(views, slope_map), lfref.shift_and_sum(views, [0.25]), atol=1e-6)
        True
    """
    batch = batches.flattened(views)
    cell = footprint.checked(fill, disparity, views)
    slopes = _checked_map(slope_map, batch, positions)
    return batches.restored(_stack(batch, slopes, interpolation, border, weights, positions, cell), views)


def tilt_shift(
    views: Tensor,
    slope: Slopes | float,
    tilt: Tensor | Sequence[float],
    interpolation: str = "linear",
    border: str = "renormalize",
    weights: Tensor | None = None,
    fill: float = 0.0,
    disparity: float | Tensor = 0.0,
    positions: Tensor | None = None,
) -> Tensor:
    """Refocus light fields on slanted planes: s(x, y) = slope + a x + b y, with x and y counted from pixel 0.

    Args:
        views: As in `per_pixel`.
        slope: Focus at the top left pixel, in pixels per view step, [N] or one number.
        tilt: Change of slope (a, b) per pixel to the right and per pixel downwards.
        interpolation: As in `per_pixel`.
        border: As in `per_pixel`.
        weights: As in `per_pixel`.
        fill: As in `per_pixel`.
        disparity: As in `per_pixel`.
        positions: As in `per_pixel`.

    Returns:
        Stacks in the order of the slopes, otherwise as `per_pixel`, [..., N, C, H, W].

    Raises:
        InputError: As `per_pixel`, or a tilt that is not two numbers.

    Example:
        >>> views = torch.rand(5, 5, 3, 48, 64)
        >>> lfref.tilt_shift(views, slope=-0.5, tilt=[0.0, 0.02]).shape  # one slope more every 50 rows
        torch.Size([1, 3, 48, 64])
    """
    batch = batches.flattened(views)
    cell = footprint.checked(fill, disparity, views)
    slopes = _checked_map(_affine_map(slope, tilt, batch), batch, positions)
    return batches.restored(_stack(batch, slopes, interpolation, border, weights, positions, cell), views)


def _affine_map(slope: Slopes | float, tilt: Tensor | Sequence[float], views: Tensor) -> Tensor:
    start = torch.as_tensor(slope, dtype=torch.float64, device=views.device).reshape(-1, 1, 1)
    change = torch.as_tensor(tilt, dtype=torch.float64, device=views.device)
    if change.shape != (2,):
        raise InputError("tilt must be two numbers, slope per pixel along x and y", got=f"shape {list(change.shape)}")
    x, y = pixels(views)
    return start + change[0] * x + change[1] * y


def _checked_map(slope_map: Tensor, views: Tensor, positions: Tensor | None) -> Tensor:
    """The slopes as float64 where the views are, [N, H, W], once they and the positions are known to be usable."""
    grid, size = batches.grid_and_size(views)
    slopes = torch.as_tensor(slope_map, dtype=torch.float64, device=views.device)
    if slopes.ndim not in (2, 3) or tuple(slopes.shape[-2:]) != size or slopes.numel() == 0:
        raise InputError(
            f"a slope map must be {list(size)} or [N, {size[0]}, {size[1]}], one slope for each pixel",
            got=f"shape {list(slopes.shape)}",
            remedy="resize the map to the views",
        )
    lines.checked_slopes(torch.stack(slopes.detach().aminmax()), grid, size, positions)
    return slopes.reshape(-1, *size)


def _stack(
    views: Tensor,
    slopes: Tensor,
    interpolation: str,
    border: str,
    weights: Tensor | None,
    positions: Tensor | None,
    cell: Footprint,
) -> Tensor:
    grid, _ = batches.grid_and_size(views)
    stand = None if positions is None else lines.checked_positions(positions, grid)
    planes = [Places(slopes=each, positions=stand) for each in slopes]
    stack, coverage = mean_of_views(views, batches.checked_weights(weights, grid), planes, interpolation, border)
    return footprint_blur.blurred(stack, cell.widths(slopes), BORDERS[border], coverage) if cell.fill > 0 else stack
