"""The plane of any layers, composited through every cell by PyTorch's operations: on any device.

The same sums as in `together`, where loops are compiled. Letters: as there; `M` cells, `T` steps of |e|.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.functional import threads
from lfref.simulator import layers as extents
from lfref.simulator import lookups, rays, scenery, truth_loops, views
from lfref.simulator.blurs import Bitmap, margin
from lfref.simulator.canvases import OVERSAMPLING
from lfref.simulator.layers import Layer
from lfref.simulator.rays import Atlas, Page
from lfref.simulator.scenery import STEPS, Filter, FocalPlane
from lfref.simulator.truth_loops import Followed, Levels, Places, Smoothed, Through

# PART together
# The plane of several layers, or of one whose rays are followed: composited through every cell, on the CPU.
#
# Letters: as in `ray_loop`; `o` samples a pixel.

LINEAR = 1.0
"""Pixels around a point that a linear look-up reads, and half a pixel for rounding."""
WORTH_A_THREAD = 1 << 22
"""Look-ups of a plane from which one more thread saves more than it costs."""


class Shelf(NamedTuple):
    """Pictures of followed layers: blurred copies that all planes share, and room for what each plane blurs anew."""

    atlas: Atlas
    copies: dict[Bitmap, range]
    """Where an atlas has the levels of a bitmap."""
    room: range
    """Where it has room for windows."""


def camera(planes: Sequence[FocalPlane]) -> Callable[[FocalPlane], Tensor]:
    """What photographs planes.

    Args:
        planes: All of them.

    Returns:
        plane -> picture, [3, H, W].
    """
    shelf = _shelf(planes)
    return lambda plane: _photograph(plane, shelf)


def _shelf(planes: Sequence[FocalPlane]) -> Shelf:
    pictures: list[Page] = []
    copies: dict[Bitmap, range] = {}
    for bitmap, n_levels in _levels(planes).items():
        copies[bitmap] = range(len(pictures), len(pictures) + n_levels)
        pictures += [_copy(bitmap, level) for level in range(n_levels)]
    room = range(len(pictures), len(pictures) + max(sum(map(_n_windows, plane.followed)) for plane in planes))
    seen = planes[0].seen
    window = [(length + 2 * seen.margin) * OVERSAMPLING for length in seen.camera.size]
    empty = np.empty((*window, 4), _dtype(planes))
    pictures += [Page(empty, empty[..., 3], 0, 0) for _ in room]
    return Shelf(rays.atlas(pictures), copies, room)


def _levels(planes: Sequence[FocalPlane]) -> dict[Bitmap, int]:
    """Of the bitmaps that do not face the camera, how many blurred copies are read."""
    found: dict[Bitmap, int] = {}
    for plane in planes:
        for layer in plane.followed:
            if not layer.surface.geometry.is_parallel:
                n_levels = math.ceil(plane.blurs(layer)[0].max()) + 1
                found[layer.bitmap] = max(n_levels, found.get(layer.bitmap, 0))
    return found


def _copy(bitmap: Bitmap, level: int) -> Page:
    beyond = margin(level)
    samples = bitmap.copy(level).numpy()
    return Page(samples, samples[..., 3], bitmap.canvas.top - beyond, bitmap.canvas.left - beyond)


def _n_windows(layer: Layer) -> int:
    return layer.surface.geometry.is_parallel + (layer.reflection is not None)


def _photograph(plane: FocalPlane, shelf: Shelf) -> Tensor:
    slope, seen, cells = plane
    through = Through(cells.p.numpy(), cells.q.numpy(), cells.weights.numpy(), plane.cell, slope)
    picture = np.zeros((3, *seen.camera.size), _dtype([plane]))
    n_look_ups = len(seen.layers) * through.weights.size * picture[0].size
    n_threads = threads.worthwhile(n_look_ups, WORTH_A_THREAD)
    work = functools.partial(_adding(plane, shelf), through, picture)
    threads.share(work, threads.bands(seen.camera.size[0], n_threads), n_threads)
    return torch.from_numpy(picture)


def _adding(plane: FocalPlane, shelf: Shelf) -> Callable[[Through, NDArray, int, int], None]:
    """The loop that a plane takes."""
    if plane.is_sorted:
        return functools.partial(truth_loops.add_sorted, _followed(plane, shelf))
    shifted = _smoothed(plane, [layer for layer in plane.seen.layers if not layer.is_traced])
    if plane.followed:
        return functools.partial(truth_loops.add_mixed, *shifted, _followed(plane, shelf))
    return functools.partial(truth_loops.add_shifted, *shifted)


def _smoothed(plane: FocalPlane, layers: Sequence[Layer]) -> tuple[Smoothed, Places]:
    """Layers that are only shifted, blurred by a cell."""
    room = _room(plane, len(layers))
    filters = [
        _blur(plane, layer.bitmap, layer.surface.geometry.form.disparity, room, k) for k, layer in enumerate(layers)
    ]
    rows, columns = np.empty((len(layers), len(plane.cells.q))), np.empty((len(layers), len(plane.cells.p)))
    for k, one in enumerate(filters):
        rows[k], columns[k] = one.rows, one.columns
    return room, Places(rows, columns)


def _room(plane: FocalPlane, n_layers: int) -> Smoothed:
    """Room for windows of a plane."""
    margin = plane.seen.margin_at(plane.slope)
    height, width = (length + 2 * margin for length in plane.seen.camera.size)
    samples = np.empty((n_layers, 4, height * OVERSAMPLING, OVERSAMPLING, width), _dtype([plane]))
    return Smoothed(samples, *np.empty((2, n_layers, height * OVERSAMPLING), np.int64))


def _blur(plane: FocalPlane, bitmap: Bitmap, disparity: float, room: Smoothed, k: int) -> Filter:
    """Fill a place with a picture that faces the camera."""
    samples = plane.seen.window(bitmap, plane.slope).numpy()
    one = scenery.cell_filter(plane.slope - disparity, plane.cells, plane.seen.margin_at(plane.slope))
    down, across = (taps.astype(samples.dtype) for taps in one[:2])
    truth_loops.smooth(samples, down, across, room.samples[k], room.first[k], room.last[k])
    return one


def _followed(plane: FocalPlane, shelf: Shelf) -> Followed:
    """Tables of the layers whose rays are followed."""
    layers, room = plane.followed, iter(shelf.room)
    places, boxes = [], []
    for layer in layers:
        geometry, reflection = layer.surface.geometry, layer.reflection
        if geometry.is_parallel:
            first = _fill(shelf, next(room), plane, layer.bitmap, geometry.form.disparity)
            boxes.append(rays.box(_taken(shelf, first), LINEAR))
        else:
            first, n_levels = shelf.copies[layer.bitmap].start, math.ceil(plane.blurs(layer)[0].max()) + 1
            boxes.append(rays.box(_copy(layer.bitmap, n_levels - 1), LINEAR))
        mirrored = reflection and _fill(shelf, next(room), plane, reflection.picture, reflection.disparity)
        places.append((first, -1 if mirrored is None else mirrored))
    spans = [extents.span(plane.seen.camera, layer.surface.geometry, abs(plane.slope)) for layer in layers]
    blurs = [plane.blurs(layer) for layer in layers]
    tables = np.array([places for places, _ in blurs]).reshape(len(layers), STEPS)
    levels = Levels(tables, np.array([steps for _, steps in blurs]))
    return Followed(rays.sights(layers, spans, boxes, places), levels, shelf.atlas, _ranks(plane), plane.crosses())


def _fill(shelf: Shelf, place: int, plane: FocalPlane, bitmap: Bitmap, disparity: float) -> int:
    """Put a blurred window into an atlas."""
    room = _room(plane, 1)
    _blur(plane, bitmap, disparity, room, 0)
    samples = room.samples[0].transpose(1, 3, 2, 0)
    frame = shelf.atlas.frames[place]
    frame[1:] = samples.shape[0], samples.shape[1] * samples.shape[2], *plane.seen.corner(plane.slope)
    shelf.atlas.samples[frame[0] : frame[0] + samples.size].reshape(samples.shape)[:] = samples
    return place


def _taken(shelf: Shelf, place: int) -> Page:
    """A picture of an atlas."""
    start, rows, columns, top, left = shelf.atlas.frames[place].tolist()
    samples = shelf.atlas.samples[start : start + rows * columns * 4].reshape(rows, columns, 4)
    return Page(samples, samples[..., 3], top, left)


def _ranks(plane: FocalPlane) -> NDArray[np.int64]:
    """As `Followed.order`."""
    counts = {True: -1, False: 0}
    order = []
    for layer in plane.seen.layers:
        is_followed = layer in plane.followed
        order.append(counts[is_followed])
        counts[is_followed] += -1 if is_followed else 1
    return np.array(order, np.int64)


def _dtype(planes: Sequence[FocalPlane]) -> np.dtype:
    layers = [layer for plane in planes for layer in plane.seen.layers]
    return layers[0].bitmap.samples.numpy().dtype if layers else np.dtype(np.float32)


CELLS_AT_ONCE = 16
"""More take memory and no less time."""

Look = Callable[[Tensor, Tensor, Tensor, Tensor, Tensor], Tensor]
"""(disparities, p, q, x, y of rays) -> premultiplied RGBA; all [M, H, W] or of one entry along some axes, float64."""
Read = Callable[[Tensor, Tensor], Tensor]
"""(X, Y), [M, H, W] -> RGBA, [M, 4, H, W]."""


def photograph(plane: FocalPlane) -> Tensor:
    """The picture of a plane, [3, H, W]."""
    slope, seen, cells = plane
    device = seen.layers[0].device
    picture = torch.zeros(3, *seen.camera.size, dtype=torch.float64, device=device)
    looks = [_look(plane, layer) for layer in seen.layers]
    q, p = (points.flatten() for points in torch.meshgrid(cells.q, cells.p, indexing="ij"))
    weights = cells.weights.flatten()
    for part in torch.stack([p, q, weights])[:, weights > 0].split(CELLS_AT_ONCE, dim=1):
        p, q, shares = (values.to(device) for values in part)
        x, y = (pixels.to(device) for pixels in seen.camera.pixels())
        rays = p[:, None, None], q[:, None, None], x + slope * p[:, None, None], y + slope * q[:, None, None]
        met = views.met(seen.layers, *rays)
        rgba = [look(disparities, *rays) for look, disparities in zip(looks, met, strict=True)]
        sights = _sorted(plane, rgba, met, *rays) if plane.is_sorted else views.composite(rgba)
        picture += torch.einsum("m,mchw->chw", shares, sights.double())
    return picture.to(seen.layers[0].bitmap.samples)


def _sorted(plane: FocalPlane, rgba: list[Tensor], met: Tensor, p: Tensor, q: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """What is seen of layers sorted at each pixel, [M, 3, H, W]; see `ray_loop.lay_shared`."""
    crosses, slopes = plane.crosses(), []
    for layer, disparities in zip(plane.seen.layers, met, strict=True):
        across, down = layer.surface.geometry.gradient_at(x - disparities * p, y - disparities * q)
        slopes.append(torch.stack([across, down]) / (1 + across * p + down * q))
    sight = torch.zeros_like(rgba[0][:, :3])
    for k, behind in enumerate(rgba):
        light = behind[:, :3]
        for m, veil in enumerate(rgba):
            if m != k:
                lead = met[m] - met[k]
                before = (lead > 0) | ((lead == 0) & (m > k))
                if crosses[m, k]:
                    e = plane.slope - (met[m] + met[k]) / 2
                    spread = e.abs() * plane.cell * torch.linalg.vector_norm(slopes[m] - slopes[k], dim=0)
                    before = torch.where(lead.abs() < spread, (0.5 + lead / spread).clamp(0, 1), before.double())
                light = light * (1 - before[:, None].to(veil) * veil[:, 3:])
        sight = sight + light
    return sight


def _look(plane: FocalPlane, layer: Layer) -> Look:
    """How a layer is seen through cells."""
    form, reflection = layer.surface.geometry.form, layer.reflection
    is_parallel = layer.surface.geometry.is_parallel
    read = _window(plane, layer.bitmap, form.disparity) if is_parallel else None
    mirrored = _window(plane, reflection.picture, reflection.disparity) if reflection else None

    def look(met: Tensor, p: Tensor, q: Tensor, x: Tensor, y: Tensor) -> Tensor:
        positions, e = (x - met * p, y - met * q), plane.slope - met
        rgba = read(*positions) if read else _copies(plane, layer, positions, e)
        if layer.highlight:
            way = (e - layer.highlight.drift) * plane.cell
            rgba[:, :3] += rgba[:, 3:] * layer.highlight.on(positions, p, q, way).to(rgba)
        if reflection and mirrored:
            behind = mirrored(x - reflection.disparity * p, y - reflection.disparity * q)
            rgba[:, :3] += reflection.share * rgba[:, 3:] * behind[:, :3]
        return rgba

    return look


def _window(plane: FocalPlane, bitmap: Bitmap, disparity: float) -> Read:
    """Linear look-ups of a picture that faces the camera, blurred by a cell."""
    one = scenery.cell_filter(plane.slope - disparity, plane.cells, plane.seen.margin_at(plane.slope))
    samples = plane.seen.window(bitmap, plane.slope)
    for axis, taps in ((-2, one.down), (-1, one.across)):
        samples = _filtered(samples, taps.tolist(), axis)
    top, left = plane.seen.corner(plane.slope)
    return lambda x, y: lookups.linear(
        samples, *torch.broadcast_tensors(x * OVERSAMPLING - left, y * OVERSAMPLING - top)
    )


def _filtered(samples: Tensor, taps: list[float], axis: int) -> Tensor:
    """Taps applied along an axis, the ends going on."""
    length, half = samples.shape[axis], len(taps) // 2
    places = torch.arange(-half, length + half, device=samples.device).clamp(0, length - 1)
    padded = samples.index_select(axis, places)
    return sum((tap * padded.narrow(axis, t, length) for t, tap in enumerate(taps)), torch.zeros_like(samples))


def _copies(plane: FocalPlane, layer: Layer, positions: tuple[Tensor, Tensor], e: Tensor) -> Tensor:
    """Linear look-ups between the two blurred copies that suit each pixel."""
    table, steps = plane.blurs(layer)
    places = torch.from_numpy(table).to(e)
    step = e.abs() * steps
    below = step.long().clamp(max=len(places) - 2)
    level = (places[below] + (step - below) * (places[below + 1] - places[below]))[:, None]
    rgba, canvas = torch.zeros(()), layer.bitmap.canvas
    for n in range(int(level.min()), int(level.max().ceil()) + 1):
        i, j = (
            at * OVERSAMPLING - start + margin(n)
            for at, start in zip(positions, (canvas.left, canvas.top), strict=True)
        )
        share = (1 - (level - n).abs()).clamp(min=0)
        rgba = rgba + share.to(layer.bitmap.samples) * lookups.linear(layer.bitmap.copy(n).movedim(-1, 0), i, j)
    return rgba
