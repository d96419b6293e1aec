"""The truth of several layers, or of one whose rays are followed: composited through every cell of the aperture.

`CellRenderer` prepares the arrays that the compiled loops of `truth_loops` read, on the CPU:
- a layer that is only shifted is blurred by its motion within a cell and read along whole rows (`BlurredLayers`);
- a traced layer that faces the camera gets such a blurred window too, in an atlas;
- a traced layer that is slanted or curved is blurred differently at each pixel: the atlas has blurred copies of its
  bitmap, and tables say between which copies each pixel lies.
`render_eagerly` takes the same sums by PyTorch's operations. It is the only form that runs on a GPU, and the reference
of the loops in tests; on the CPU it takes several times as long.
Letters: `K` layers, `J I` rows and columns of cells, `M` cells at once, `e` relative slope, `X Y` as in `surfaces`.
"""

import functools
import math
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.functional import threads
from lfref.simulator import lookups, rays, truth_loops, views
from lfref.simulator.bitmaps import Bitmap, margin
from lfref.simulator.canvases import OVERSAMPLING, Box
from lfref.simulator.focal_planes import BLUR_STEPS, CellFilter, FocalPlane
from lfref.simulator.layers import Layer, disparity_span
from lfref.simulator.rays import AtlasEntry
from lfref.simulator.truth_loops import ApertureCells, BlurredLayers, BlurTables, CellPositions, TracedLayers

LINEAR_MARGIN = 1.0
"""Pixels around a point that a linear look-up reads: one sample, and half a pixel for rounding."""
WORTH_A_THREAD = 1 << 22
"""Look-ups of a plane from which one more thread saves more than it costs."""
CELLS_AT_ONCE = 16
"""Cells that the eager form composites at once; more take memory and no less time."""


class CellRenderer:
    """Composites the planes of a stack through every cell, on the CPU.

    Its atlas has the blurred copies of all bitmaps, which the planes share, and memory for windows, which each plane
    fills anew.
    """

    def __init__(self, planes: Sequence[FocalPlane]) -> None:
        n_copies: dict[Bitmap, int] = {}
        for plane in planes:
            for layer in plane.traced:
                if not layer.surface.geometry.is_parallel:
                    n_copies[layer.bitmap] = max(_n_levels(plane, layer), n_copies.get(layer.bitmap, 0))
        entries: list[AtlasEntry] = []
        self.copies: dict[Bitmap, int] = {}  # index of the first copy of each bitmap
        for bitmap, n_levels in n_copies.items():
            self.copies[bitmap] = len(entries)
            entries += [_blurred_entry(bitmap, level) for level in range(n_levels)]
        self.first_window = len(entries)
        n_windows = max(
            sum(layer.surface.geometry.is_parallel + (layer.reflection is not None) for layer in plane.traced)
            for plane in planes
        )
        layers = [layer for plane in planes for layer in plane.layers]
        self.dtype = layers[0].bitmap.samples.numpy().dtype if layers else np.dtype(np.float32)
        largest = [(length + 2 * planes[0].windows.margin) * OVERSAMPLING for length in planes[0].camera.size]
        empty = np.empty((*largest, 4), self.dtype)
        entries += [AtlasEntry(empty, empty[..., 3], 0, 0)] * n_windows
        self.atlas = rays.atlas(entries)

    def render(self, plane: FocalPlane) -> Tensor:
        """The picture of a plane, [3, H, W]."""
        cells = plane.cells
        aperture = ApertureCells(cells.p.numpy(), cells.q.numpy(), cells.weights.numpy(), plane.cell_width, plane.slope)
        picture = np.zeros((3, *plane.camera.size), self.dtype)
        traced = self._traced_layers(plane)
        if plane.is_sorted:
            composite = functools.partial(truth_loops.composite_sorted, traced)
        else:
            shifted = self._shifted_layers(plane, [layer for layer in plane.layers if not layer.is_traced])
            composite = functools.partial(truth_loops.composite_fixed, *shifted, traced)
        n_look_ups = len(plane.layers) * aperture.weights.size * picture[0].size
        n_threads = threads.worthwhile(n_look_ups, WORTH_A_THREAD)
        work = functools.partial(composite, aperture, picture)
        threads.share(work, threads.bands(plane.camera.size[0], n_threads), n_threads)
        return torch.from_numpy(picture)

    def _shifted_layers(self, plane: FocalPlane, layers: Sequence[Layer]) -> tuple[BlurredLayers, CellPositions]:
        """Layers that are only shifted, blurred by a cell, and where they are read through each cell."""
        blurred = self._allocate(plane, len(layers))
        rows, columns = np.empty((len(layers), len(plane.cells.q))), np.empty((len(layers), len(plane.cells.p)))
        for k, layer in enumerate(layers):
            cell = self._blur(plane, layer.bitmap, layer.surface.geometry.form.disparity, blurred, k)
            rows[k], columns[k] = cell.rows, cell.columns
        return blurred, CellPositions(rows, columns)

    def _allocate(self, plane: FocalPlane, n_layers: int) -> BlurredLayers:
        height, width = (length + 2 * plane.margin for length in plane.camera.size)
        samples = np.empty((n_layers, 4, height * OVERSAMPLING, OVERSAMPLING, width), self.dtype)
        return BlurredLayers(samples, *np.empty((2, n_layers, height * OVERSAMPLING), np.int64))

    def _blur(self, plane: FocalPlane, bitmap: Bitmap, disparity: float, blurred: BlurredLayers, k: int) -> CellFilter:
        """Fill layer k with the window of a bitmap that faces the camera, blurred by a cell."""
        samples = plane.window(bitmap).numpy()
        cell = plane.filter(disparity)
        down, across = (taps.astype(samples.dtype) for taps in cell[:2])
        truth_loops.blur_layer(samples, down, across, blurred.samples[k], blurred.first[k], blurred.last[k])
        return cell

    def _traced_layers(self, plane: FocalPlane) -> TracedLayers:
        """Tables of the layers whose rays are followed; their windows in the atlas are filled."""
        layers, window = plane.traced, self.first_window
        bitmaps, boxes = [], []
        for layer in layers:
            shape, reflection = layer.surface.geometry, layer.reflection
            if shape.is_parallel:
                own, window = window, window + 1
                boxes.append(self._fill_window(own, plane, layer.bitmap, shape.form.disparity))
            else:
                own = self.copies[layer.bitmap]
                # The widest copy that this plane reads bounds all the others.
                boxes.append(rays.visible_box(_blurred_entry(layer.bitmap, _n_levels(plane, layer) - 1), LINEAR_MARGIN))
            mirrored = -1
            if reflection:
                mirrored, window = window, window + 1
                self._fill_window(mirrored, plane, reflection.picture, reflection.disparity)
            bitmaps.append((own, mirrored))
        spans = [disparity_span(plane.camera, layer.surface.geometry, abs(plane.slope)) for layer in layers]
        blurs = [plane.blur_levels(layer) for layer in layers]
        levels = np.array([levels for levels, _ in blurs]).reshape(len(layers), BLUR_STEPS)
        tables = BlurTables(levels, np.array([steps for _, steps in blurs]))
        described = rays.ray_layers(layers, spans, boxes, bitmaps)
        return TracedLayers(described, tables, self.atlas, _layer_order(plane), plane.crosses())

    def _fill_window(self, n: int, plane: FocalPlane, bitmap: Bitmap, disparity: float) -> Box:
        """Put a window, blurred by a cell, into the atlas; returns the box in which it is visible."""
        blurred = self._allocate(plane, 1)
        self._blur(plane, bitmap, disparity, blurred, 0)
        # [4, rows, phases, columns] -> rows, columns with their phases side by side, channels.
        samples = blurred.samples[0].transpose(1, 3, 2, 0)
        samples = samples.reshape(samples.shape[0], -1, 4)
        frame, (top, left) = self.atlas.frames[n], plane.window_corner()
        frame[1:] = *samples.shape[:2], top, left
        self.atlas.samples[frame[0] : frame[0] + samples.size] = samples.reshape(-1)
        return rays.visible_box(AtlasEntry(samples, samples[..., 3], top, left), LINEAR_MARGIN)


def _n_levels(plane: FocalPlane, layer: Layer) -> int:
    """Number of blurred copies that a plane reads of a slanted or curved layer."""
    return math.ceil(plane.blur_levels(layer)[0].max()) + 1


def _blurred_entry(bitmap: Bitmap, level: int) -> AtlasEntry:
    beyond = margin(level)
    samples = bitmap.blurred(level).numpy()
    return AtlasEntry(samples, samples[..., 3], bitmap.canvas.top - beyond, bitmap.canvas.left - beyond)


def _layer_order(plane: FocalPlane) -> NDArray[np.int64]:
    """As `TracedLayers.order`."""
    order, n_shifted, n_traced, traced = [], 0, 0, plane.traced
    for layer in plane.layers:
        if layer in traced:
            order.append(-1 - n_traced)
            n_traced += 1
        else:
            order.append(n_shifted)
            n_shifted += 1
    return np.array(order, np.int64)


def render_eagerly(plane: FocalPlane) -> Tensor:
    """The picture of a plane by PyTorch's operations, on any device, [3, H, W]."""
    cells, layers = plane.cells, plane.layers
    device = layers[0].device
    picture = torch.zeros(3, *plane.camera.size, dtype=torch.float64, device=device)
    windows = {
        bitmap: _blurred_window(plane, bitmap, disparity)
        for layer in layers
        for bitmap, disparity in (
            [(layer.bitmap, layer.surface.geometry.form.disparity)] * layer.surface.geometry.is_parallel
            + ([(layer.reflection.picture, layer.reflection.disparity)] if layer.reflection else [])
        )
    }
    x, y = (pixels.to(device) for pixels in plane.camera.pixels())
    q, p = (points.flatten() for points in torch.meshgrid(cells.q, cells.p, indexing="ij"))
    weights = cells.weights.flatten()
    for part in torch.stack([p, q, weights])[:, weights > 0].split(CELLS_AT_ONCE, dim=1):
        p, q, shares = (values.to(device)[:, None, None] for values in part)
        ray = p, q, x + plane.slope * p, y + plane.slope * q
        disparities = views.ray_disparities(layers, *ray)
        rgba = [_layer_rgba(plane, layer, windows, D, *ray) for layer, D in zip(layers, disparities, strict=True)]
        radiance = _composite_crossing(plane, rgba, disparities, *ray) if plane.is_sorted else views.composite(rgba)
        picture += torch.einsum("m,mchw->chw", shares[:, 0, 0], radiance.double())
    return picture.to(layers[0].bitmap.samples)


def _layer_rgba(
    plane: FocalPlane,
    layer: Layer,
    windows: dict[Bitmap, Tensor],
    D: Tensor,
    p: Tensor,
    q: Tensor,
    x: Tensor,
    y: Tensor,
) -> Tensor:
    """A layer as seen through cells, RGBA [M, 4, H, W], by rays that meet it at the disparities D [M, H, W]."""
    positions, e = (x - D * p, y - D * q), plane.slope - D
    if layer.surface.geometry.is_parallel:
        rgba = _read_window(plane, windows[layer.bitmap], *positions)
    else:
        # Between the two blurred copies that suit each pixel.
        table, steps = plane.blur_levels(layer)
        levels = torch.from_numpy(table).to(e)
        step = e.abs() * steps
        below = step.long().clamp(max=len(levels) - 2)
        level = (levels[below] + (step - below) * (levels[below + 1] - levels[below]))[:, None]
        rgba, canvas = torch.zeros(()), layer.bitmap.canvas
        for n in range(int(level.min()), int(level.max().ceil()) + 1):
            i, j = (
                at * OVERSAMPLING - start + margin(n)
                for at, start in zip(positions, (canvas.left, canvas.top), strict=True)
            )
            share = (1 - (level - n).abs()).clamp(min=0)
            copy = layer.bitmap.blurred(n).movedim(-1, 0)
            rgba = rgba + share.to(layer.bitmap.samples) * lookups.linear_at(copy, i, j)
    if layer.highlight:
        spread = (e - layer.highlight.drift) * plane.cell_width
        rgba[:, :3] += rgba[:, 3:] * layer.highlight.light_at(positions, p, q, spread).to(rgba)
    if layer.reflection:
        disparity, window = layer.reflection.disparity, windows[layer.reflection.picture]
        mirrored = _read_window(plane, window, x - disparity * p, y - disparity * q)
        rgba[:, :3] += layer.reflection.share * rgba[:, 3:] * mirrored[:, :3]
    return rgba


def _blurred_window(plane: FocalPlane, bitmap: Bitmap, disparity: float) -> Tensor:
    """The window of a bitmap that faces the camera, blurred by a cell, [4, h, w]."""
    samples, cell = plane.window(bitmap), plane.filter(disparity)
    for axis, taps in ((-2, cell.down.tolist()), (-1, cell.across.tolist())):
        length, half = samples.shape[axis], len(taps) // 2
        index = torch.arange(-half, length + half, device=samples.device).clamp(0, length - 1)
        padded = samples.index_select(axis, index)
        samples = sum((tap * padded.narrow(axis, t, length) for t, tap in enumerate(taps)), torch.zeros_like(samples))
    return samples


def _read_window(plane: FocalPlane, window: Tensor, x: Tensor, y: Tensor) -> Tensor:
    top, left = plane.window_corner()
    return lookups.linear_at(window, *torch.broadcast_tensors(x * OVERSAMPLING - left, y * OVERSAMPLING - top))


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
