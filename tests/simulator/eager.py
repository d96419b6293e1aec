"""Views and truths by PyTorch's operations, ray by ray: the reference of the simulator's compiled loops."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.simulator import bitmaps
from lfref.simulator.bitmaps import FINE, OVERSAMPLING, TAPS, Bitmap
from lfref.simulator.focal_planes import FocalPlane
from lfref.simulator.layers import Highlight, Layer
from lfref.simulator.surfaces import Geometry, Plane
from lfref.simulator.truth import _copy_corner

Positions = tuple[Tensor, Tensor]
"""X and Y in pixels, float64; if they form a grid, X has one row and Y one column."""


def as_rays(p: Tensor, q: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Aperture points [M] as [M, 1, 1], and pixels of three axes, float64."""
    p, q, x, y = (value.double() for value in (p, q, x, y))
    return p[:, None, None], q[:, None, None], x[(None,) * (3 - x.dim())], y[(None,) * (3 - y.dim())]


def ray_positions(geometry: Geometry, x: Tensor, y: Tensor, p: Tensor, q: Tensor) -> Positions:
    """Points (X, Y) where rays meet a surface; if it faces the camera, as a grid of columns and rows."""
    shape = torch.broadcast_shapes(x.shape, y.shape, p.shape)
    # One pixel is enough where disparity is the same everywhere; all pixels would undo the grid.
    pixels = slice(1) if geometry.is_parallel else slice(None)
    disparity = geometry.ray_disparity(x[..., pixels, pixels], y[..., pixels, pixels], p, q)
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


def light_at(lobe: Highlight, positions: Positions, p: Tensor, q: Tensor, spread: float | Tensor = 0.0) -> Tensor:
    """Light of a highlight at points of its surface, blurred by a box `spread` pixels wide, float64, [M, 3, H, W]."""
    offset_x = positions[0] - lobe.x - lobe.drift * p
    offset_y = positions[1] - lobe.y - lobe.drift * q
    # A box of width b has the variance b^2 / 12, and a wider lobe is lower.
    variance = lobe.width**2 + spread**2 / 12
    light = torch.exp(-(offset_x**2 + offset_y**2) / (2 * variance)) * lobe.width**2 / variance
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


def linear_at(bitmap: Tensor, i: Tensor, j: Tensor) -> Tensor:
    """A bitmap [C, h, w] at any positions, [M, H, W] each, read linearly; result [M, C, H, W]."""
    n_channels, height, width = bitmap.shape
    samples = bitmap.movedim(0, -1).reshape(-1, n_channels)
    i, j = i.clamp(0, width - 1), j.clamp(0, height - 1)
    column, row = i.long().clamp(max=width - 2), j.long().clamp(max=height - 2)
    across, down = ((at - whole).to(samples)[..., None] for at, whole in ((i, column), (j, row)))
    first = row * width + column
    upper = torch.lerp(samples[first], samples[first + 1], across)
    lower = torch.lerp(samples[first + width], samples[first + width + 1], across)
    return torch.lerp(upper, lower, down).movedim(-1, -3)


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
    return torch.stack([layer.surface.geometry.ray_disparity(x, y, p, q).expand(shape) for layer in layers])


def render_eagerly(plane: FocalPlane) -> Tensor:
    """The picture of a plane by PyTorch's operations, [3, H, W]."""
    cells, layers = plane.cells, plane.layers
    picture = torch.zeros(3, *plane.camera.size, dtype=torch.float64)
    windows = [_eager_windows(plane, layer) for layer in layers]
    x, y = plane.camera.pixels()
    q, p = (points.flatten() for points in torch.meshgrid(cells.q, cells.p, indexing="ij"))
    weights = cells.weights.flatten()
    # 16 cells at once: more take memory and no less time.
    for part in torch.stack([p, q, weights])[:, weights > 0].split(16, dim=1):
        p, q, shares = (values[:, None, None] for values in part)
        ray = p, q, x + plane.slope * p, y + plane.slope * q
        disparities = ray_disparities(layers, *ray)
        rgba = [_layer_rgba(plane, *of_layer, *ray) for of_layer in zip(layers, windows, disparities, strict=True)]
        radiance = _composite_crossing(plane, rgba, disparities, *ray) if plane.is_sorted else composite(rgba)
        picture += torch.einsum("m,mchw->chw", shares[:, 0, 0], radiance.double())
    return picture.to(layers[0].bitmap.samples)


class EagerWindow(NamedTuple):
    """A blurred window of PyTorch."""

    samples: Tensor  # premultiplied RGBA, [4, h, w]
    top: int  # Y of the first row in samples
    left: int  # X of the first column in samples

    def at(self, x: Tensor, y: Tensor) -> Tensor:
        """Linear look-ups at points (X, Y) [M, H, W] each, [M, 4, H, W]."""
        places = torch.broadcast_tensors(x * FINE - self.left, y * FINE - self.top)
        return linear_at(self.samples, *places)


def _eager_windows(plane: FocalPlane, layer: Layer) -> list[EagerWindow]:
    """The windows of a layer and of the picture that it mirrors, if any."""
    shape, reflection = layer.surface.geometry, layer.reflection
    is_parallel = shape.is_parallel
    own = _blurred_window(plane, layer.bitmap, shape.form.disparity) if is_parallel else _mixed_window(plane, layer)
    return [own, _blurred_window(plane, reflection.picture, reflection.disparity)] if reflection else [own]


def _layer_rgba(
    plane: FocalPlane, layer: Layer, windows: list[EagerWindow], D: Tensor, p: Tensor, q: Tensor, x: Tensor, y: Tensor
) -> Tensor:
    """A layer as seen through cells, RGBA [M, 4, H, W], by rays that meet it at the disparities D [M, H, W]."""
    positions, e = (x - D * p, y - D * q), plane.slope - D
    rgba = windows[0].at(*positions)
    if layer.highlight:
        spread = (e - layer.highlight.drift) * plane.cell_width
        rgba[:, :3] += rgba[:, 3:] * light_at(layer.highlight, positions, p, q, spread).to(rgba)
    if layer.reflection:
        disparity = layer.reflection.disparity
        mirrored = windows[1].at(x - disparity * p, y - disparity * q)
        rgba[:, :3] += layer.reflection.share * rgba[:, 3:] * mirrored[:, :3]
    return rgba


def _mixed_window(plane: FocalPlane, layer: Layer) -> EagerWindow:
    """The window of a slanted or curved layer: between the two blurred copies that suit each point."""
    blur = plane.copy_blur(layer)
    top, left, bottom, right = plane.read_box(layer, blur.copies())
    rows, columns = (torch.arange(*ends) for ends in ((top, bottom), (left, right)))
    disparity = layer.surface.geometry.disparity_at(columns.double() / FINE, rows.double()[:, None] / FINE)
    levels = torch.from_numpy(blur.levels).to(disparity)
    step = (plane.slope - disparity).abs().clamp(min=blur.nearest) * blur.steps
    below = step.long().clamp(max=len(levels) - 2)
    level = levels[below] + (step - below).clamp(max=1) * (levels[below + 1] - levels[below])
    mixed = torch.zeros(())
    for n in blur.copies():
        share, copy = (1 - (level - n).abs()).clamp(min=0), layer.bitmap.blurred(n)
        i, j = (
            (at - start).clamp(0, length - 1)
            for at, start, length in zip((rows, columns), _copy_corner(layer.bitmap, n), copy.shape, strict=False)
        )
        mixed = mixed + share.to(copy) * copy[i][:, j].movedim(-1, 0)
    return EagerWindow(mixed, top, left)


def _blurred_window(plane: FocalPlane, bitmap: Bitmap, disparity: float) -> EagerWindow:
    """The window of a bitmap that faces the camera, blurred by a cell."""
    samples, cell = plane.window(bitmap), plane.filter(disparity)
    for axis, taps in ((-2, cell.down.tolist()), (-1, cell.across.tolist())):
        length, half = samples.shape[axis], len(taps) // 2
        index = torch.arange(-half, length + half).clamp(0, length - 1)
        padded = samples.index_select(axis, index)
        samples = sum((tap * padded.narrow(axis, t, length) for t, tap in enumerate(taps)), torch.zeros_like(samples))
    return EagerWindow(samples, *plane.window_corner())


def _composite_crossing(
    plane: FocalPlane, rgba: list[Tensor], disparities: Tensor, p: Tensor, q: Tensor, x: Tensor, y: Tensor
) -> Tensor:
    """Radiance of layers that are sorted at each pixel, [M, 3, H, W]; see `rays.composite_crossing`."""
    crosses, gradients = plane.crosses(), []
    for layer, D in zip(plane.layers, disparities, strict=True):
        across, down = layer.surface.geometry.gradient_at(x - D * p, y - D * q)
        gradients.append(torch.stack([across, down]) / (1 + across * p + down * q))
    radiance = torch.zeros_like(rgba[0][:, :3])
    for k, behind in enumerate(rgba):
        light = behind[:, :3]
        for m, front in enumerate(rgba):
            if m != k:
                lead = disparities[m] - disparities[k]
                before = (lead > 0) | ((lead == 0) & (m > k))
                if crosses[m, k]:
                    e = plane.slope - (disparities[m] + disparities[k]) / 2
                    gradient = torch.linalg.vector_norm(gradients[m] - gradients[k], dim=0)
                    spread = e.abs() * plane.cell_width * gradient
                    before = torch.where(lead.abs() < spread, (0.5 + lead / spread).clamp(0, 1), before.double())
                light = light * (1 - before[:, None].to(front) * front[:, 3:])
        radiance = radiance + light
    return radiance
