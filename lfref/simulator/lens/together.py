"""The plane of several layers, or of one whose rays are followed: composited through every cell, on the CPU.

Letters: as in `ray_loop`; `o` samples a pixel.
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
from lfref.simulator.canvases import OVERSAMPLING
from lfref.simulator.lens import cell_blur, smooth_loop, truth_loop
from lfref.simulator.lens.cell_blur import Filter
from lfref.simulator.lens.ray_truth_loop import Levels
from lfref.simulator.lens.scenery import STEPS, FocalPlane
from lfref.simulator.lens.smooth_loop import Smoothed
from lfref.simulator.lens.truth_loop import Followed, Places, Through
from lfref.simulator.painting import extents
from lfref.simulator.painting.layers import Layer
from lfref.simulator.rays import ray_tables
from lfref.simulator.rays.ray_loop import Atlas
from lfref.simulator.rays.ray_tables import Page
from lfref.simulator.reading.blurs import Bitmap, margin

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
    return Shelf(ray_tables.atlas(pictures), copies, room)


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
        return functools.partial(truth_loop.add_sorted, _followed(plane, shelf))
    shifted = _smoothed(plane, [layer for layer in plane.seen.layers if not layer.is_traced])
    if plane.followed:
        return functools.partial(truth_loop.add_mixed, *shifted, _followed(plane, shelf))
    return functools.partial(truth_loop.add_shifted, *shifted)


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
    one = cell_blur.cell_filter(plane.slope - disparity, plane.cells, plane.seen.margin_at(plane.slope))
    down, across = (taps.astype(samples.dtype) for taps in one[:2])
    smooth_loop.smooth(samples, down, across, room.samples[k], room.first[k], room.last[k])
    return one


def _followed(plane: FocalPlane, shelf: Shelf) -> Followed:
    """Tables of the layers whose rays are followed."""
    layers, room = plane.followed, iter(shelf.room)
    places, boxes = [], []
    for layer in layers:
        geometry, reflection = layer.surface.geometry, layer.reflection
        if geometry.is_parallel:
            first = _fill(shelf, next(room), plane, layer.bitmap, geometry.form.disparity)
            boxes.append(ray_tables.box(_taken(shelf, first), LINEAR))
        else:
            first, n_levels = shelf.copies[layer.bitmap].start, math.ceil(plane.blurs(layer)[0].max()) + 1
            boxes.append(ray_tables.box(_copy(layer.bitmap, n_levels - 1), LINEAR))
        mirrored = reflection and _fill(shelf, next(room), plane, reflection.picture, reflection.disparity)
        places.append((first, -1 if mirrored is None else mirrored))
    spans = [extents.span(plane.seen.camera, layer.surface.geometry, abs(plane.slope)) for layer in layers]
    blurs = [plane.blurs(layer) for layer in layers]
    tables = np.array([places for places, _ in blurs]).reshape(len(layers), STEPS)
    levels = Levels(tables, np.array([steps for _, steps in blurs]))
    return Followed(
        ray_tables.sights(layers, spans, boxes, places), levels, shelf.atlas, _ranks(plane), plane.crosses()
    )


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
