"""The truth: the stack that a lens with the full continuous aperture A photographs.

    I_s(x, y) = mean over (p, q) in A of the radiance through (p, q) at (x + s p, y + s q)

The integral needs sampling only because surfaces hide parts of each other. Each plane has its visible layers and cells
of the aperture (`focal_planes`). For a single layer that is only shifted, the sum over all cells is a linear filter
(`filter_layer`). Otherwise every layer is blurred by its motion within a cell, all are composited through the middle of
every cell, and averaged, with two numbers of cells, of which an extrapolation is made. `render` prepares the arrays of
`truth_loops`: blurred windows of layers that face the camera, and for slanted or curved ones, which are blurred
differently at each point, windows mixed of blurred copies.
Letters: `N` planes, `s` slope, `e` relative slope, `K` layers, `J I` rows and columns of cells, `M` cells at once,
`X Y` as in `surfaces`.
"""

import functools
import math
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref import geometry
from lfref.functional import loops
from lfref.simulator import bitmaps, focal_planes, rays, truth_loops
from lfref.simulator.bitmaps import FINE, OVERSAMPLING, Bitmap
from lfref.simulator.focal_planes import CellFilter, FocalPlane
from lfref.simulator.layers import Layer, disparity_span
from lfref.simulator.rays import AtlasEntry
from lfref.simulator.scene import Camera
from lfref.simulator.truth_loops import ApertureCells, BlurredLayers, CellPositions, TracedLayers


def stack(layers: Sequence[Layer], camera: Camera, slopes: geometry.Slopes, averaged: int = 1) -> Tensor:
    """Photograph layers, from far to near, at each slope [N]: [N, 3, H, W]; `averaged` pixels a side will be one."""
    values = geometry.checked_slopes(slopes, camera.grid, camera.size).tolist()
    planes = focal_planes.focal_planes(layers, camera, values, averaged=averaged)
    pictures = []
    for plane in planes:
        if not plane.layers:
            pictures.append(layers[0].bitmap.samples.new_zeros(3, *camera.size))
        elif len(plane.layers) == 1 and not plane.traced:
            pictures.append(filter_layer(plane))
        elif plane.coarser:
            # Richardson: with half as many cells, the leading error is four times as large.
            picture = render(plane)
            pictures.append(picture + (picture - render(plane.coarser)) / 3)
        else:
            pictures.append(render(plane))
    return torch.stack(pictures)


def filter_layer(plane: FocalPlane) -> Tensor:
    """The picture of a single layer that is only shifted, by a few separable filters, [3, H, W].

    The weighted sum over a group of rows of cells with equal weights is one filter along columns and one along rows.
    """
    (layer,) = plane.layers
    samples = plane.window(layer.bitmap)[:3]
    picture = samples.new_zeros(3, *plane.camera.size)
    cell = plane.filter(layer.surface.geometry.form.disparity)
    shares, groups = np.unique(plane.cells.weights.numpy().round(12), axis=0, return_inverse=True)
    for group, share in enumerate(shares):
        if not share.any():
            continue
        in_group = (groups.reshape(-1) == group).astype(float)
        top, down = focal_planes.combined_taps(cell.down, cell.rows, in_group)
        left, across = focal_planes.combined_taps(cell.across, cell.columns, share)
        truth_loops.filter_at_pixels(samples.numpy(), down, across, top, left, FINE, picture.numpy())
    return picture


def render(plane: FocalPlane) -> Tensor:
    """The picture of a plane by compiled loops, [3, H, W]."""
    cells, n_pixels = plane.cells, math.prod(plane.camera.size)
    # About 4 million look-ups take as long as the start of one more thread.
    n_threads = loops.worthwhile(len(plane.layers) * cells.weights.numel() * n_pixels, 1 << 22)
    aperture = ApertureCells(cells.p.numpy(), cells.q.numpy(), cells.weights.numpy(), plane.cell_width, plane.slope)
    picture = np.zeros((3, *plane.camera.size), plane.layers[0].bitmap.samples.numpy().dtype)
    traced = _traced_layers(plane, n_threads)
    if plane.is_sorted:
        composite = functools.partial(truth_loops.composite_sorted, traced)
    else:
        layers = [layer for layer in plane.layers if not layer.is_traced]
        shifted = _allocate(plane, len(layers), picture.dtype)
        rows, columns = np.empty((len(layers), len(cells.q))), np.empty((len(layers), len(cells.p)))
        for k, layer in enumerate(layers):
            cell = _blur(plane, layer.bitmap, layer.surface.geometry.form.disparity, shifted, k)
            rows[k], columns[k] = cell.rows, cell.columns
        composite = functools.partial(truth_loops.composite_fixed, shifted, CellPositions(rows, columns), traced)
    work = functools.partial(composite, aperture, picture)
    loops.share(work, loops.bands(plane.camera.size[0], n_threads), n_threads)
    return torch.from_numpy(picture)


def _allocate(plane: FocalPlane, n_layers: int, dtype: np.dtype) -> BlurredLayers:
    height, width = (length + 2 * plane.margin for length in plane.camera.size)
    samples = np.empty((n_layers, 4, height * FINE, FINE, width), dtype)
    return BlurredLayers(samples, *np.empty((2, n_layers, height * FINE), np.int64))


def _blur(plane: FocalPlane, bitmap: Bitmap, disparity: float, blurred: BlurredLayers, k: int) -> CellFilter:
    """Fill layer k with the window of a bitmap that faces the camera, blurred by a cell."""
    samples = plane.window(bitmap).numpy()
    cell = plane.filter(disparity)
    down, across = (taps.astype(samples.dtype) for taps in cell[:2])
    truth_loops.blur_layer(samples, down, across, blurred.samples[k], blurred.first[k], blurred.last[k])
    return cell


def _traced_layers(plane: FocalPlane, n_threads: int) -> TracedLayers:
    """Tables and blurred windows of the layers whose rays are followed."""
    layers = plane.traced
    windows: list[AtlasEntry] = []
    boxes, indices = [], []
    for layer in layers:
        shape, reflection, own = layer.surface.geometry, layer.reflection, len(windows)
        if shape.is_parallel:
            windows.append(_blurred_entry(plane, layer.bitmap, shape.form.disparity))
        else:
            windows.append(_mixed_entry(plane, layer, n_threads))
        boxes.append(rays.visible_box(windows[own], 1, FINE))
        if reflection:
            windows.append(_blurred_entry(plane, reflection.picture, reflection.disparity))
        indices.append((own, own + 1 if reflection else -1))
    spans = [disparity_span(plane.camera, layer.surface.geometry, abs(plane.slope)) for layer in layers]
    described = rays.ray_layers(layers, spans, boxes, indices)
    # All layers from far to near: index among shifted layers, or -1 - index among traced layers.
    order: list[int] = []
    n_traced = 0
    for layer in plane.layers:
        is_traced = layer in layers
        n_traced += is_traced
        order.append(-n_traced if is_traced else len(order) - n_traced)
    return TracedLayers(described, rays.atlas(windows, FINE), np.array(order, np.int64), plane.crosses())


def _entry(samples: NDArray[np.floating], top: int, left: int) -> AtlasEntry:
    """The entry of a window whose samples lie phase by phase, [4, rows, o, columns]."""
    opacity = samples[3].swapaxes(1, 2).reshape(samples.shape[1], -1)
    return AtlasEntry(samples, opacity, top, left)


def _blurred_entry(plane: FocalPlane, bitmap: Bitmap, disparity: float) -> AtlasEntry:
    """The window of a bitmap that faces the camera, blurred by a cell."""
    blurred = _allocate(plane, 1, bitmap.samples.numpy().dtype)
    _blur(plane, bitmap, disparity, blurred, 0)
    return _entry(blurred.samples[0], *plane.window_corner())


def _mixed_entry(plane: FocalPlane, layer: Layer, n_threads: int) -> AtlasEntry:
    """The window of a slanted or curved layer, mixed of blurred copies of its bitmap."""
    blur = plane.copy_blur(layer)
    top, left, bottom, right = plane.read_box(layer, blur.copies())
    dtype = layer.bitmap.samples.numpy().dtype
    window = np.zeros((4, bottom - top, FINE, math.ceil((right - left) / FINE)), dtype)
    form = np.array(layer.surface.geometry.form, np.float64)
    for level in blur.copies():
        copy, frame = layer.bitmap.blurred(level).numpy(), _copy_corner(layer.bitmap, level)
        work = functools.partial(truth_loops.add_copy, copy, frame, level, form, blur, (top, left), window)
        loops.share(work, loops.bands(bottom - top, n_threads), n_threads)
    return _entry(window, top, left)


def _copy_corner(bitmap: Bitmap, level: int) -> tuple[int, int]:
    """Y and X of the first sample of a blurred copy, in samples."""
    canvas, margin = bitmap.canvas, bitmaps.margin(level)
    return canvas.top * FINE // OVERSAMPLING - margin, canvas.left * FINE // OVERSAMPLING - margin
