"""The truth: the stack that a lens with the full continuous aperture A photographs.

    I_s(x, y) = mean over (p, q) in A of the radiance through (p, q) at (x + s p, y + s q)

The integral needs sampling only because surfaces hide parts of each other. Steps for each plane:
1. Choose the visible layers and the number of cells of the aperture (`focal_planes`).
2. A single layer that is only shifted needs no sampling: the sum over all cells is a linear filter (`filter_layer`).
3. Otherwise blur every layer by its motion within a cell, composite through the middle of every cell, and take the
   weighted mean. `CellRenderer` prepares the arrays that the compiled loops of `truth_loops` read, on the CPU:
   - a layer that is only shifted is blurred by its motion within a cell and read along whole rows (`BlurredLayers`);
   - a traced layer that faces the camera gets such a blurred window too, in an atlas;
   - a traced layer that is slanted or curved is blurred differently at each pixel: the atlas has blurred copies of its
     bitmap, and tables say between which copies each pixel lies.
   `render_eagerly` takes the same sums by PyTorch's operations. It is the only form that runs on a GPU, and the
   reference of the loops in tests; on the CPU it takes several times as long.
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
from lfref.errors import InputError
from lfref.functional import loops
from lfref.simulator import bitmaps, focal_planes, rays, truth_loops, views
from lfref.simulator.bitmaps import OVERSAMPLING, Bitmap, Box
from lfref.simulator.focal_planes import CellFilter, FocalPlane
from lfref.simulator.layers import Layer, disparity_span
from lfref.simulator.rays import AtlasEntry
from lfref.simulator.scene import Camera
from lfref.simulator.truth_loops import ApertureCells, BlurredLayers, BlurTables, CellPositions, TracedLayers


def stack(layers: Sequence[Layer], camera: Camera, slopes: geometry.Slopes, n_cells: int | None = None) -> Tensor:
    """Photograph layers at each slope: a stack of the layers' type and device, [N, 3, H, W].

    Args:
        layers: Layers from far to near, painted for a reach of the greatest |slope|.
        camera: The lens and the size of the picture.
        slopes: Slopes of the planes in pixels per view step, [N].
        n_cells: Cells along the aperture's longer side; None takes as many as each plane needs.
    """
    values = geometry.checked_slopes(slopes, camera.grid, camera.size).tolist()
    if n_cells is not None and n_cells < 1:
        raise InputError("n_cells must be at least 1", got=n_cells)
    planes = focal_planes.focal_planes(layers, camera, values, n_cells)
    on_cpu = layers[0].device.type == "cpu"
    render = CellRenderer(planes).render if on_cpu else render_eagerly
    pictures = []
    for plane in planes:
        if not plane.layers:
            pictures.append(layers[0].bitmap.samples.new_zeros(3, *camera.size))
        elif len(plane.layers) == 1 and not plane.traced:
            pictures.append(filter_layer(plane))
        else:
            pictures.append(render(plane))
    return torch.stack(pictures)


def filter_layer(plane: FocalPlane) -> Tensor:
    """The picture of a single layer that is only shifted, by a few separable filters, [3, H, W].

    Rows of cells with equal weights (all rows of a square, pairs of rows of a disc) form a group. The weighted sum over
    the cells of a group is one filter along columns and one filter along rows.
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
        if samples.device.type == "cpu":
            truth_loops.filter_at_pixels(samples.numpy(), down, across, top, left, OVERSAMPLING, picture.numpy())
        else:
            rows = _filter_matrix(top, down, picture.shape[1], samples.shape[1]).to(samples)
            columns = _filter_matrix(left, across, picture.shape[2], samples.shape[2]).to(samples)
            picture += rows @ samples @ columns.mT
    return picture


def _filter_matrix(first: int, taps: NDArray, length: int, n_samples: int) -> Tensor:
    """A filter at every pixel as a matrix, float64, [length, n_samples]."""
    matrix = torch.zeros(length, n_samples, dtype=torch.float64)
    pixels = torch.arange(length)[:, None]
    matrix[pixels, first + OVERSAMPLING * pixels + torch.arange(len(taps))] = torch.from_numpy(taps)
    return matrix


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
        self.atlas = rays.atlas([*entries, *[AtlasEntry(empty, empty[..., 3], 0, 0)] * n_windows])

    def render(self, plane: FocalPlane) -> Tensor:
        """The picture of a plane, [3, H, W]."""
        cells = plane.cells
        aperture = ApertureCells(cells.p.numpy(), cells.q.numpy(), cells.weights.numpy(), plane.cell_width, plane.slope)
        picture = np.zeros((3, *plane.camera.size), self.dtype)
        traced = self._traced_layers(plane)
        if plane.is_sorted:
            composite = functools.partial(truth_loops.composite_sorted, traced)
        else:
            layers = [layer for layer in plane.layers if not layer.is_traced]
            shifted = self._allocate(plane, len(layers))
            rows, columns = np.empty((len(layers), len(cells.q))), np.empty((len(layers), len(cells.p)))
            for k, layer in enumerate(layers):
                cell = self._blur(plane, layer.bitmap, layer.surface.geometry.form.disparity, shifted, k)
                rows[k], columns[k] = cell.rows, cell.columns
            positions = CellPositions(rows, columns)
            composite = functools.partial(truth_loops.composite_fixed, shifted, positions, traced)
        # About 4 million look-ups take as long as the start of one more thread.
        n_threads = loops.worthwhile(len(plane.layers) * aperture.weights.size * picture[0].size, 1 << 22)
        work = functools.partial(composite, aperture, picture)
        loops.share(work, loops.bands(plane.camera.size[0], n_threads), n_threads)
        return torch.from_numpy(picture)

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
        indices, boxes = [], []
        for layer in layers:
            shape, reflection = layer.surface.geometry, layer.reflection
            if shape.is_parallel:
                own, window = window, window + 1
                boxes.append(self._fill_window(own, plane, layer.bitmap, shape.form.disparity))
            else:
                own = self.copies[layer.bitmap]
                # The widest copy that this plane reads bounds all other copies.
                boxes.append(rays.visible_box(_blurred_entry(layer.bitmap, _n_levels(plane, layer) - 1), reads=1))
            mirrored = -1
            if reflection:
                mirrored, window = window, window + 1
                self._fill_window(mirrored, plane, reflection.picture, reflection.disparity)
            indices.append((own, mirrored))
        spans = [disparity_span(plane.camera, layer.surface.geometry, abs(plane.slope)) for layer in layers]
        blurs = [plane.blur_levels(layer) for layer in layers]
        tables = BlurTables(np.array([levels for levels, _ in blurs], ndmin=2), np.array([steps for _, steps in blurs]))
        described = rays.ray_layers(layers, spans, boxes, indices)
        # All layers from far to near: index among shifted layers, or -1 - index among traced layers.
        order: list[int] = []
        n_traced = 0
        for layer in plane.layers:
            is_traced = layer in layers
            n_traced += is_traced
            order.append(-n_traced if is_traced else len(order) - n_traced)
        return TracedLayers(described, tables, self.atlas, np.array(order, np.int64), plane.crosses())

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
        return rays.visible_box(AtlasEntry(samples, samples[..., 3], top, left), reads=1)


def _n_levels(plane: FocalPlane, layer: Layer) -> int:
    """Number of blurred copies that a plane reads of a slanted or curved layer."""
    return math.ceil(plane.blur_levels(layer)[0].max()) + 1


def _blurred_entry(bitmap: Bitmap, level: int) -> AtlasEntry:
    beyond = bitmaps.margin(level)
    samples = bitmap.blurred(level).numpy()
    return AtlasEntry(samples, samples[..., 3], bitmap.canvas.top - beyond, bitmap.canvas.left - beyond)


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
    # 16 cells at once: more take memory and no less time.
    for part in torch.stack([p, q, weights])[:, weights > 0].split(16, dim=1):
        p, q, shares = (values.to(device)[:, None, None] for values in part)
        ray = p, q, x + plane.slope * p, y + plane.slope * q
        disparities = views.ray_disparities(layers, *ray)
        rgba = [_layer_rgba(plane, layer, windows, D, *ray) for layer, D in zip(layers, disparities, strict=True)]
        radiance = _composite_crossing(plane, rgba, disparities, *ray) if plane.is_sorted else views.composite(rgba)
        picture += torch.einsum("m,mchw->chw", shares[:, 0, 0], radiance.double())
    return picture.to(layers[0].bitmap.samples)


def _layer_rgba(
    plane: FocalPlane, layer: Layer, windows: dict[Bitmap, Tensor], D: Tensor, p: Tensor, q: Tensor, x: Tensor,
    y: Tensor,
) -> Tensor:  # fmt: skip
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
                at * OVERSAMPLING - start + bitmaps.margin(n)
                for at, start in zip(positions, (canvas.left, canvas.top), strict=True)
            )
            share = (1 - (level - n).abs()).clamp(min=0)
            copy = layer.bitmap.blurred(n).movedim(-1, 0)
            rgba = rgba + share.to(layer.bitmap.samples) * bitmaps.linear_at(copy, i, j)
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
    return bitmaps.linear_at(window, *torch.broadcast_tensors(x * OVERSAMPLING - left, y * OVERSAMPLING - top))


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
