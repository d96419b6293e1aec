"""Views: pictures of layers from points of the aperture, and the contents of the central view.

Layers are laid over bands of rows from far to near. A layer whose views are shifted copies is read along whole rows
(`shifts`); the rays to other layers are followed one by one (`rays`), and those to all layers if any cross, which are
then sorted by depth at each pixel. A traced layer that faces the camera is read by the same shifts, to the bit.
Letters: `p q` aperture point in view steps, `v u` row and column of aperture points, `x y` pixel from the picture's
centre, `M` aperture points, `K` layers, `n` bitmap of the atlas.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from lfref import geometry
from lfref.functional import loops
from lfref.functional.loops import compiled
from lfref.simulator import bitmaps, rays, shifts
from lfref.simulator.bitmaps import OVERSAMPLING, Bitmap, Canvas, Floats
from lfref.simulator.layers import Layer, disparity_span, is_backdrop
from lfref.simulator.rays import Atlas, AtlasEntry, Float64s, RayLayers, RayRow
from lfref.simulator.scene import Camera
from lfref.simulator.shifts import ShiftTaps

MOSTLY_OPAQUE = 0.5
"""Opacity above which a pixel is said to show a surface."""

DrawRows = Callable[[int, int], None]
"""Function (first row, one past the last) that lays layers over these rows of all pictures."""


def views(layers: Sequence[Layer], camera: Camera) -> Tensor:
    """Pictures of layers from all view points: radiance, float32, [V, U, 3, H, W]."""
    q, p = (geometry.angular_offsets(n_views) for n_views in camera.grid)
    return render(layers, camera, p, q)


def render(layers: Sequence[Layer], camera: Camera, p: Tensor, q: Tensor, slope: float = 0.0) -> Tensor:
    """Pictures from aperture points (p [U], q [V]), the plane of `slope` in place: float32, [V, U, 3, H, W]."""
    # A backdrop that is only shifted writes every pixel; other layers are laid over black.
    allocate = np.empty if is_backdrop(layers[0].surface) and not layers[0].is_traced else np.zeros
    picture = allocate((len(q), len(p), 3, *camera.size), np.float32)
    if any(layer.is_sorted for layer in layers):
        drawers = [_traced_drawer(layers, camera, p, q, slope, picture)]
    else:
        drawers = [
            _traced_drawer([layer], camera, p, q, slope, picture)
            if layer.is_traced
            else _shifted_drawer(layer, camera, p, q, slope, picture)
            for layer in layers
        ]

    def draw_band(top: int, end: int) -> None:
        for draw in drawers:
            draw(top, end)

    height = camera.size[0]
    # 8 rows of 7 x 7 views stay in a core's second cache until all layers are drawn.
    bands = itertools.pairwise([*range(0, height, 8), height])
    # Plain threads, started for the call: unlike OpenMP's threads, they work after a fork.
    loops.share(draw_band, bands, torch.get_num_threads())
    return torch.from_numpy(picture)


def _shifted_drawer(layer: Layer, camera: Camera, p: Tensor, q: Tensor, slope: float, picture: Floats) -> DrawRows:
    """A function that draws a layer whose pictures are shifted copies."""
    bitmap = shifts.trimmed(layer.bitmap.samples.numpy(), is_backdrop(layer.surface))
    disparity = layer.surface.geometry.form.disparity
    across, down = _shift_taps(layer.bitmap.canvas, disparity, camera, p, q, slope)
    return lambda top, end: shifts.composite_shifted(bitmap, across, down, picture, top, end)


def _shift_taps(
    canvas: Canvas, disparity: float, camera: Camera, p: Tensor, q: Tensor, slope: float
) -> tuple[ShiftTaps, ShiftTaps]:
    """Look-ups of a bitmap that faces the camera along rows [U], and along columns [V]."""
    across, down = (
        shifts.shift_taps((pixels.min() + (slope - disparity) * points) * OVERSAMPLING - edge)
        for pixels, points, edge in zip(camera.pixels(), (p, q), (canvas.left, canvas.top), strict=True)
    )
    return across, down


class Viewpoints(NamedTuple):
    """A grid of aperture points, and the look-ups of every bitmap of an atlas from these points."""

    p: Float64s  # columns, [U]
    q: Float64s  # rows, [V]
    slope: float  # slope of the plane that is at the same place in all pictures
    across: ShiftTaps  # look-ups along rows, [N, U] and [N, U, 4]
    down: ShiftTaps  # look-ups along columns, [N, V] and [N, V, 4]


def _traced_drawer(
    layers: Sequence[Layer], camera: Camera, p: Tensor, q: Tensor, slope: float, picture: Floats
) -> DrawRows:
    """A function that draws layers by following their rays; several layers are sorted at each pixel."""
    entries: list[AtlasEntry] = []
    indices, taps = [], []

    def add(bitmap: Bitmap, is_parallel: bool, disparity: float) -> int:
        # Shifts read a bitmap channel by channel, look-ups sample by sample.
        samples = (bitmap.samples if is_parallel else bitmap.interleaved).numpy()
        entries.append(AtlasEntry(samples, bitmap.samples[3].numpy(), bitmap.canvas.top, bitmap.canvas.left))
        taps.append(_shift_taps(bitmap.canvas, disparity, camera, p, q, slope))
        return len(entries) - 1

    for layer in layers:
        shape, reflection = layer.surface.geometry, layer.reflection
        own = add(layer.bitmap, shape.is_parallel, shape.form.disparity)
        indices.append((own, add(reflection.picture, True, reflection.disparity) if reflection else -1))
    spans = [disparity_span(camera, layer.surface.geometry, abs(slope)) for layer in layers]
    boxes = [rays.visible_box(entries[own], 2, OVERSAMPLING) for own, _ in indices]
    tables, atlas = rays.ray_layers(layers, spans, boxes, indices), rays.atlas(entries, OVERSAMPLING)
    across, down = (ShiftTaps(*map(np.stack, zip(*axis, strict=True))) for axis in zip(*taps, strict=True))
    points = Viewpoints(p.numpy(), q.numpy(), slope, across, down)
    return lambda top, end: draw_rays(tables, atlas, points, picture, top, end)


@compiled
def draw_rays(layers: RayLayers, atlas: Atlas, points: Viewpoints, picture: Floats, top: int, end: int) -> None:
    """Lay one layer over rows of all pictures [V, U, 3, H, W], or fill them with layers sorted at every pixel.

    The atlas has bitmaps [4, h, w] of layers that face the camera, and [h, w, 4] of other layers.
    """
    n_layers, width = len(layers.forms), picture.shape[4]
    # All layers at once: the order differs from pixel to pixel.
    at, order = np.zeros((n_layers, 5, width)), np.empty(n_layers, np.int64)
    rgba, mirrored = np.zeros((n_layers, 4, width), picture.dtype), np.empty((4, width), picture.dtype)
    # An interpolated line of every bitmap, even and odd columns apart, [N, 4, 2, columns / 2 + padding].
    lines = np.zeros((len(atlas.frames), 4, 2, atlas.frames[:, 2].max() // 2 + 2 * shifts.PAD), atlas.samples.dtype)
    for y in range(top, end):
        for v in range(points.q.size):
            _interpolate_lines(layers, atlas, points, v, y, lines)
            for u in range(points.p.size):
                row = rays.rays_of_row(points.p[u], points.q[v], points.slope, 0.0, y, picture[v, u])
                for k in range(n_layers):
                    begin, stop = _layer_row(layers, atlas, points, k, u, row, lines, at[k], rgba[k], mirrored)
                    if n_layers == 1:
                        rays.composite_over(rgba[k], begin, stop, picture[v, u, :, y])
                    rgba[k, :, :begin] = 0
                    rgba[k, :, stop:] = 0
                if n_layers > 1:
                    rays.composite_by_depth(rgba, at[:, 2], order, picture[v, u, :, y])


@compiled
def _interpolate_lines(layers: RayLayers, atlas: Atlas, points: Viewpoints, v: int, y: int, lines: Floats) -> None:
    """Fill `lines`, one per bitmap that faces the camera, with its row at row y of the views from aperture row v."""
    for k in range(len(layers.forms)):
        # Mirrored pictures (1) always face the camera, a layer's own bitmap (0) only if the layer does.
        for which in range(0 if layers.is_parallel[k] else 1, 2):
            n = layers.bitmaps[k, which]
            if n >= 0:
                start, rows, columns = atlas.frames[n, 0], atlas.frames[n, 1], atlas.frames[n, 2]
                samples = atlas.samples[start : start + 4 * rows * columns].reshape(4, rows, columns)
                first = points.down.starts[n, v] + 2 * y
                shifts.interpolate_rows(samples, first, points.down.weights[n, v], 0, columns // 2, lines[n])


@compiled
def _layer_row(
    layers: RayLayers, atlas: Atlas, points: Viewpoints, k: int, u: int, row: RayRow, lines: Floats, at: Float64s,
    rgba: Floats, mirrored: Floats,
) -> tuple[int, int]:  # fmt: skip
    """Fill `at` and `rgba` with layer k at a row of pixels; returns the first one and one past the last."""
    begin, stop = rays.visible_pixels(layers, k, row, rgba.shape[1])
    if begin >= stop:
        return 0, 0
    # 1. Find where the rays meet the surface. Read the bitmap there: by lines if it faces the camera, else by points.
    rays.intersect(layers, k, row, begin, stop, at)
    n, mirrored_n = layers.bitmaps[k, 0], layers.bitmaps[k, 1]
    if layers.is_parallel[k]:
        _read_line(atlas, points, n, u, begin, stop, lines, rgba)
    else:
        frame = atlas.frames[n]
        for x in range(begin, stop):
            i, j = at[0, x] * atlas.density - frame[4], at[1, x] * atlas.density - frame[3]
            rgba[0, x], rgba[1, x], rgba[2, x], rgba[3, x] = bitmaps.cubic_sample(
                atlas.samples, frame[0], frame[1], frame[2], i, j
            )
    # 2. Remove the overshoot of the cubic, first from the colours: they depend on the opacity as it was read.
    one, zero = rgba.dtype.type(1), rgba.dtype.type(0)
    if layers.is_backdrop[k]:
        rgba[3, begin:stop] = 1
    for c in range(3):
        for x in range(begin, stop):
            rgba[c, x] = shifts.clipped_colour(rgba[c, x], rgba[3, x])
    for x in range(begin, stop):
        rgba[3, x] = min(max(rgba[3, x], zero), one)
    # 3. A highlight and a mirrored picture add light in proportion to the opacity.
    if layers.highlights[k, 3] > 0:
        rays.add_highlight(layers, k, row, begin, stop, at, rgba)
    if mirrored_n >= 0:
        _read_line(atlas, points, mirrored_n, u, begin, stop, lines, mirrored)
        share = rgba.dtype.type(layers.mirrors[k, 0])
        for c in range(3):
            for x in range(begin, stop):
                rgba[c, x] += share * rgba[3, x] * max(mirrored[c, x], zero)
    return begin, stop


@compiled
def _read_line(
    atlas: Atlas, points: Viewpoints, n: int, u: int, begin: int, stop: int, lines: Floats, rgba: Floats
) -> None:
    """Read pixels of a bitmap that faces the camera from its interpolated lines; pixels beyond the bitmap are 0."""
    start, weights = points.across.starts[n, u], points.across.weights[n, u]
    left, right = shifts.pixels_reading(start, 0, atlas.frames[n, 2] // 2, rgba.shape[1])
    for c in range(4):
        rgba[c, begin:left] = 0
        rgba[c, right:stop] = 0
        shifts.read_shifted(lines[n, c], start, weights, max(left, begin), max(min(right, stop), left, begin), rgba[c])


def all_in_focus(layers: Sequence[Layer], camera: Camera) -> Tensor:
    """The central view through a pinhole, linear and without the sensor's effects, float32, [3, H, W]."""
    return views(layers, replace(camera, grid=(1, 1)))[0, 0]


def disparity(layers: Sequence[Layer], camera: Camera) -> Tensor:
    """Disparity of the nearest surface that each pixel of the central view shows, float32, [H, W]; 0 without one."""
    opacities, disparities = _central_layers(layers, camera)
    nearest = torch.where(opacities > MOSTLY_OPAQUE, disparities, -torch.inf).amax(0)
    return torch.where(nearest.isfinite(), nearest, 0.0).float()


def masks(layers: Sequence[Layer], camera: Camera, n_surfaces: int) -> Tensor:
    """Share of each surface of the scene in the pixels of the central view, float32, [n_surfaces, H, W]."""
    opacities, disparities = _central_layers(layers, camera)
    ranks = torch.arange(len(layers), dtype=disparities.dtype)[:, None, None]
    depths = disparities if any(layer.is_sorted for layer in layers) else ranks
    shares = opacities.new_zeros(n_surfaces, *camera.size)
    for k, layer in enumerate(layers):
        lead = depths - depths[k]
        is_before = (lead > 0) | ((lead == 0) & (ranks > k))
        shares[layer.index] = opacities[k] * (1 - is_before * opacities).prod(0)
    return shares


def _central_layers(layers: Sequence[Layer], camera: Camera) -> tuple[Tensor, Tensor]:
    """Opacities, float32, and disparities, float64, of layers in the central view, [K, H, W] each."""
    x, y = (pixels[0] for pixels in camera.pixels())
    # Rays of the central view meet all surfaces at their own (x, y), where bitmaps have samples.
    opacities = [Bitmap(layer.bitmap.canvas, layer.bitmap.samples[3:]).window(camera.size)[0] for layer in layers]
    disparities = [layer.surface.geometry.disparity_at(x, y).expand(camera.size) for layer in layers]
    return torch.stack(opacities)[:, ::OVERSAMPLING, ::OVERSAMPLING].clamp(0, 1), torch.stack(disparities)
