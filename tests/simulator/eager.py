"""Views by PyTorch's operations, ray by ray: the reference of the simulator's compiled loops."""

from collections.abc import Sequence

import torch
from torch import Tensor

from lfref.simulator import bitmaps
from lfref.simulator.bitmaps import OVERSAMPLING, TAPS, Bitmap
from lfref.simulator.layers import Highlight, Layer
from lfref.simulator.surfaces import Geometry, Plane

Positions = tuple[Tensor, Tensor]
"""X and Y in pixels, float64; if they form a grid, X has one row and Y one column."""


def as_rays(p: Tensor, q: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Aperture points [M] as [M, 1, 1], and pixels of three axes, float64."""
    p, q, x, y = (value.double() for value in (p, q, x, y))
    return p[:, None, None], q[:, None, None], x[(None,) * (3 - x.dim())], y[(None,) * (3 - y.dim())]


def gradient_at(geometry: Geometry, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Derivatives of the disparity along X and along Y at points of the central view."""
    form = geometry.form
    offset_x, offset_y = (x - form.centre_x) / form.radius, (y - form.centre_y) / form.radius
    steepness = -4 * form.bulge / form.radius * (1 - offset_x**2 - offset_y**2).clamp(min=0)
    return form.a + steepness * offset_x, form.b + steepness * offset_y


def ray_disparity(geometry: Geometry, x: Tensor, y: Tensor, p: Tensor, q: Tensor) -> Tensor:
    """Disparity D where the rays from aperture points (p, q) to pixels (x, y) meet a surface, by Newton's method."""
    form, disparity = geometry.form, geometry.disparity_at(x, y)
    if not form.bulge:
        return disparity / (1 + form.a * p + form.b * q)
    disparity = disparity + torch.zeros_like(p + q)
    for _ in range(12):
        at_x, at_y = x - disparity * p, y - disparity * q
        slope_x, slope_y = gradient_at(geometry, at_x, at_y)
        disparity = disparity - (disparity - geometry.disparity_at(at_x, at_y)) / (1 + slope_x * p + slope_y * q)
    return disparity


def ray_positions(geometry: Geometry, x: Tensor, y: Tensor, p: Tensor, q: Tensor) -> Positions:
    """Points (X, Y) where rays meet a surface; if it faces the camera, as a grid of columns and rows."""
    shape = torch.broadcast_shapes(x.shape, y.shape, p.shape)
    # One pixel is enough where disparity is the same everywhere; all pixels would undo the grid.
    pixels = slice(1) if geometry.is_parallel else slice(None)
    disparity = ray_disparity(geometry, x[..., pixels, pixels], y[..., pixels, pixels], p, q)
    at_x, at_y = x - disparity * p, y - disparity * q
    if at_x.shape[-2] == 1 and at_y.shape[-1] == 1:
        return at_x.expand(shape[0], 1, shape[2]), at_y.expand(shape[0], shape[1], 1)
    return at_x.expand(shape), at_y.expand(shape)


def rgba_at(layer: Layer, p: Tensor, q: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """The layer at pixels (x, y), which broadcast with [M, H, W], from aperture points (p, q) [M], [M, 4, H, W]."""
    p, q, x, y = as_rays(p, q, x, y)
    positions = ray_positions(layer.surface.geometry, x, y, p, q)
    rgba = bitmaps.clip_premultiplied(read_cubic(layer.bitmap, positions))
    if layer.highlight:
        rgba[:, :3] += rgba[:, 3:] * light_at(layer.highlight, positions, p, q).to(rgba)
    if layer.reflection:
        mirrored_at = ray_positions(Plane(layer.reflection.disparity), x, y, p, q)
        mirrored = read_cubic(layer.reflection.picture, mirrored_at)[:, :3].clamp(min=0)
        rgba[:, :3] += layer.reflection.share * rgba[:, 3:] * mirrored
    return rgba


def light_at(lobe: Highlight, positions: Positions, p: Tensor, q: Tensor) -> Tensor:
    """Light of a highlight at points of its surface, float64, [M, 3, H, W]."""
    offset_x = positions[0] - lobe.x - lobe.drift * p
    offset_y = positions[1] - lobe.y - lobe.drift * q
    light = torch.exp(-(offset_x**2 + offset_y**2) / (2 * lobe.width**2))
    return light[:, None] * light.new_tensor(lobe[:3])[:, None, None]


def read_cubic(bitmap: Bitmap, positions: Positions) -> Tensor:
    """Values of a bitmap at points of the surface, by cubic look-ups, [M, C, H, W]."""
    x, y = positions
    i, j = x * OVERSAMPLING - bitmap.canvas.left, y * OVERSAMPLING - bitmap.canvas.top
    read = bitmaps.cubic_on_grid if i.shape[-2] == j.shape[-1] == 1 else cubic_at
    return read(bitmap.samples, i, j)


def cubic_at(bitmap: Tensor, i: Tensor, j: Tensor) -> Tensor:
    """A bitmap [C, h, w] at any positions, [M, H, W] each, float64; result [M, C, H, W]."""
    n_channels, height, width = bitmap.shape
    samples = bitmap.movedim(0, -1).reshape(-1, n_channels)
    columns, across = bitmaps._cubic_taps(i, width)
    rows, down = bitmaps._cubic_taps(j, height)
    result = samples.new_zeros(*i.shape, n_channels)
    for row in range(TAPS):
        line = torch.zeros_like(result)
        for column in range(TAPS):
            line += samples[rows[..., row] * width + columns[..., column]] * across[..., column, None]
        result += line * down[..., row, None]
    return result.movedim(-1, -3)


def radiance(layers: Sequence[Layer], p: Tensor, q: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Light that reaches pixels through aperture points.

    Arguments as for `Layer.rgba_at`, result [M, 3, H, W], float32.
    """
    rgba = [rgba_at(layer, p, q, x, y) for layer in layers]
    if any(layer.is_sorted for layer in layers):
        disparities = ray_disparities(layers, *as_rays(p, q, x, y))
        order = disparities.argsort(dim=0, stable=True)[:, :, None].expand(-1, -1, 4, -1, -1)
        rgba = list(torch.stack(rgba).gather(0, order))
    return composite(rgba)


def composite(rgba: Sequence[Tensor]) -> Tensor:
    """Radiance [M, 3, H, W] of layers in front of black, premultiplied [M, 4, H, W] each, from far to near."""
    picture = rgba[0][:, :3]
    for nearer in rgba[1:]:
        picture = nearer[:, :3] + picture * (1 - nearer[:, 3:])
    return picture


def ray_disparities(layers: Sequence[Layer], p: Tensor, q: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Disparity at which rays (as from `layers.as_rays`) meet each layer, [K, M, H, W]."""
    shape = torch.broadcast_shapes(p.shape, q.shape, x.shape, y.shape)
    return torch.stack([ray_disparity(layer.surface.geometry, x, y, p, q).expand(shape) for layer in layers])
