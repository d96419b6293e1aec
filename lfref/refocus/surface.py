"""Focus on anything: a slope for every pixel, the tilted plane of a view camera, a homography for every view.

`I(x, y) = sum_uv w_uv L[v, u](p_uv(x, y)) / sum_uv w_uv`, over views that have a sample there: pixel (x, y) of the
picture is read at matrix (x, y, 1), then moved by slope times the view's offset. PyTorch gathers samples by index, so
that everything is differentiable twice, forwards too, also in slopes and matrices.
A plane of the scene maps the pixels of one pinhole camera onto those of another by a homography, so that cameras may
stand anywhere. There is no `fill_factor` here: a surface's positions say nothing of light from other depths.
Letters: `u v` view column and row, `x y w` homogeneous pixel of the picture, `s` slope in pixels per view step.
Sources: Vaish et al., "Synthetic aperture focusing using a shear-warp factorization of the viewing transform", 2005
(`tilt_shift`); Isaksen et al., "Dynamically reparameterized light fields", 2000; Vaish et al., "Using plane + parallax
for calibrating dense camera arrays", 2004 (`homography`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError, chosen
from lfref.geometry import Slopes
from lfref.refocus import batches
from lfref.refocus.sampling import BORDERS, FARTHEST, INTERPOLATIONS, ON_VIEW, Border, Interpolation


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
    cameras = batches.even(grid) if positions is None else batches.checked_positions(positions, grid)
    planes = [ViewMap(slopes=plane, positions=cameras) for plane in slopes.reshape(-1, *size)]
    stack = _mean_of_views(batch, batches.checked_weights(weights, grid), planes, interpolation, border)
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
        InputError: As `per_pixel`.

    Example:
        >>> views = torch.rand(5, 5, 3, 48, 64)
        >>> lfref.tilt_shift(views, slope=-0.5, tilt=[0.0, 0.02]).shape  # one slope more every 50 rows
        torch.Size([1, 3, 48, 64])
    """
    batches.check(views)
    focus = slope if isinstance(slope, Tensor) else geometry.as_slopes(slope)  # a tensor keeps its derivatives
    start = focus.to(views.device, torch.float64).reshape(-1, 1, 1)
    right, down = torch.as_tensor(tilt, dtype=torch.float64, device=views.device)
    rows, columns = (torch.arange(n, dtype=torch.float64, device=views.device) for n in views.shape[-2:])
    slope_map = start + right * columns + down * rows[:, None]
    return per_pixel(views, slope_map, interpolation, border, weights, positions)


def homography(
    views: Tensor,
    matrices: Tensor,
    interpolation: str = "linear",
    border: str = "renormalize",
    weights: Tensor | None = None,
) -> Tensor:
    """Refocus light fields through a homography for every plane and view.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        matrices: From the output pixel (x, y, 1) to the view's pixel (x w, y w, w), with w > 0 in front of the
            camera, [N, V, U, 3, 3], or [V, U, 3, 3] for one plane. Those of views of weight 0 may be anything.
        interpolation: `nearest`, `linear` or `cubic`.
        border: `renormalize` (only views with a sample there count), `edge`, `zero` or `wrap`. Points behind a camera
            (w <= 0) have no sample under any of them.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.

    Returns:
        Stacks in the order of the planes, type (float32 for integers) and device of the views, [..., N, C, H, W].
        A pixel that no weighted view covers is 0.

    Raises:
        InputError: Views, matrices, weights or names that cannot be used.

    Example:
        >>> views = torch.rand(5, 5, 3, 48, 64)
        >>> still = torch.eye(3).expand(5, 5, 3, 3)
        >>> torch.allclose(lfref.homography(views, still)[0], views.mean((0, 1)), atol=1e-6)
        True
    """
    batch = batches.flattened(views)
    aperture = batches.checked_weights(weights, (batch.shape[1], batch.shape[2]))
    values = torch.as_tensor(matrices, dtype=torch.float64, device=batch.device)
    expected = (*aperture.shape, 3, 3)
    if values.ndim not in (4, 5) or values.shape[-4:] != expected or len(values) == 0:
        raise InputError(f"matrices must be [N, *{list(expected)}]", got=f"shape {list(values.shape)}")
    planes = [ViewMap(matrices=of_views) for of_views in values.reshape(-1, *expected)]
    return batches.restored(_mean_of_views(batch, aperture, planes, interpolation, border), views)


class ViewMap(NamedTuple):
    """Positions in each view of what is at the pixels of one plane: by matrices, or by slopes and cameras."""

    matrices: Tensor | None = None
    """From pixels of the picture to those of each view, float64, [V, U, 3, 3]."""
    slopes: Tensor | None = None
    """At each pixel, in pixels per view step, float64, [H, W]."""
    positions: Tensor | None = None
    """(v, u) of each view from the middle of the grid, in view steps, float64, CPU, [V, U, 2]."""


def _mean_of_views(
    views: Tensor, aperture: Tensor, planes: Sequence[ViewMap], interpolation: str, border: str
) -> Tensor:
    """Weighted mean, at each pixel, of the views [B, V, U, C, H, W] that have a sample there; 0 where none has."""
    method = chosen("interpolation", interpolation, INTERPOLATIONS)
    rule = chosen("border", border, BORDERS)
    rows, columns = (torch.arange(n, dtype=torch.float64, device=views.device) for n in views.shape[-2:])
    images = []
    for plane in planes:
        image = torch.zeros_like(batches.radiance(views[:, 0, 0]))
        coverage = torch.zeros(views.shape[-2:], dtype=torch.float64, device=views.device)
        for v, u in aperture.nonzero().tolist():
            x, y, visible = columns[None], rows[:, None], torch.ones_like(coverage, dtype=torch.bool)
            if plane.matrices is not None:
                x, y, w = (row[0] * x + row[1] * y + row[2] for row in plane.matrices[v, u])
                visible = w > 0
                # Divided by 1 instead of 0 behind the camera: those are left out, but NaN would reach the gradients.
                w = torch.where(visible, w, 1.0)
                x, y = x / w, y / w
            if plane.slopes is not None and plane.positions is not None:
                down, right = plane.positions[v, u].tolist()
                x, y = x + plane.slopes * right, y + plane.slopes * down
            samples, has_sample = sample(batches.radiance(views[:, v, u]), x, y, method, rule)
            counted, weight = has_sample & visible, float(aperture[v, u])
            image = image + torch.where(counted, samples, 0.0) * weight
            coverage = coverage + counted.to(coverage) * weight
        images.append(image * torch.where(coverage > 0, 1 / coverage, 0.0).to(image))
    return torch.stack(images, dim=1)


def sample(images: Tensor, x: Tensor, y: Tensor, method: Interpolation, border: Border) -> tuple[Tensor, Tensor]:
    """Read images [..., H, W] at any positions in pixels, float64, that broadcast to [P...].

    Returns samples [..., P...], and where there are some, [P...]: on the image if only samples count, else everywhere.
    """
    taps, has_sample = [], torch.ones_like(x, dtype=torch.bool)
    for exact, length in zip((y, x), images.shape[-2:], strict=True):
        position = (exact + 0.5).floor() if method.rounds else exact
        within = position.clamp(-FARTHEST, FARTHEST)
        whole = within.detach().floor()
        weights = enumerate(method.weights(within - whole))
        taps.append([border.tap(whole.long() - method.before + i, weight, length) for i, weight in weights])
        if border.counts_only_samples:
            has_sample = has_sample & (position >= -ON_VIEW) & (position <= length - 1 + ON_VIEW)
    flat, width = images.flatten(-2), images.shape[-1]
    total = torch.zeros((), dtype=images.dtype, device=images.device)
    for row, row_weight in taps[0]:
        for column, column_weight in taps[1]:
            weight, index = (row_weight * column_weight).to(images), row * width + column
            # Far faster than `flat[..., index]`.
            samples = flat.gather(-1, index.reshape(-1).expand(*flat.shape[:-1], -1))
            total = total + samples.reshape(*flat.shape[:-1], *index.shape) * weight
    return total, has_sample
