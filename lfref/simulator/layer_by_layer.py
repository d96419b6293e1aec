"""Views made in bands of rows, one layer after the other laid over the band: on the CPU the fastest way.

Layers that face the camera and look the same from everywhere go through the compiled loops; others are read point by
point. Threads are plain ones, started for the call, as in shift-and-sum: they work after a fork.
Letters: as in `render`.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
from torch import Tensor

from lfref import geometry
from lfref.simulator import compiled, view_kernel
from lfref.simulator.bitmaps import Layer
from lfref.simulator.canvases import OVERSAMPLING
from lfref.simulator.scene import Camera
from lfref.simulator.surfaces import Plane

BAND = 8
"""Rows of all views that are finished before the next: they stay in a core's second cache."""

Cover = Callable[[int, int], None]
"""(first row, one past the last row): lays a layer over these rows of the picture."""


def can_serve(layers: Sequence[Layer], camera: Camera) -> bool:
    """Whether no layer is in front of another at some pixels and behind it at others.

    Args:
        layers: From far to near.
        camera: The views.
    """
    spans = [_span(layer, camera) for layer in layers]
    return all(far[1] <= near[0] for far, near in itertools.pairwise(spans))


def _span(layer: Layer, camera: Camera) -> tuple[float, float]:
    """Least and greatest disparity that any pixel of any view sees; of a dome, that it has anywhere."""
    if not isinstance(layer.surface.geometry, Plane):
        return layer.disparities(camera.size)
    # A plane's lie in the corners.
    x, y = (pixels.flatten()[[0, -1]] for pixels in camera.pixels())
    p, q = (points[[0, -1]] for points in camera.view_points())
    met = layer.surface.geometry.met_at(x[:, None, None, None], y[:, None, None], p[:, None], q)
    return float(met.min()), float(met.max())


def views(layers: Sequence[Layer], camera: Camera) -> Tensor:
    """Pictures from all view points of layers that `can_serve`.

    Args:
        layers: From far to near, on the CPU.
        camera: The views.

    Returns:
        Radiance, float32, [V, U, 3, H, W].
    """
    # Only a plain copy may go over what memory happens to hold.
    make = np.empty if layers[0].hides and _is_shifted(layers[0]) else np.zeros
    picture = make((*camera.grid, 3, *camera.size), np.float32)
    covers = [_cover(layer, camera, picture) for layer in layers]
    height = camera.size[0]
    bands = [(top, min(top + BAND, height)) for top in range(0, height, BAND)]

    def finish(band: tuple[int, int]) -> None:
        for cover in covers:
            cover(*band)

    n_threads = min(torch.get_num_threads(), len(bands))
    if n_threads == 1:
        list(map(finish, bands))
    else:
        with ThreadPoolExecutor(n_threads) as pool:
            list(pool.map(finish, bands))
    return torch.from_numpy(picture)


def _cover(layer: Layer, camera: Camera, picture: np.ndarray) -> Cover:
    if _is_shifted(layer):
        return _shifted(layer, camera, picture)
    return _seen(layer, camera, torch.from_numpy(picture))


def _is_shifted(layer: Layer) -> bool:
    return layer.surface.geometry.is_parallel and not layer.is_view_dependent


def _shifted(layer: Layer, camera: Camera, picture: np.ndarray) -> Cover:
    """A layer of which all views are shifted copies."""
    samples, canvas = layer.bitmap.samples.numpy(), layer.bitmap.canvas
    sheet = compiled.filled(samples[:3]) if layer.hides else compiled.outlined(samples)
    disparity, _ = layer.disparities(camera.size)
    across, down = (
        compiled.shifts((pixels.min() - disparity * geometry.angular_offsets(n_views)) * OVERSAMPLING - edge)
        for pixels, n_views, edge in zip(camera.pixels(), camera.grid[::-1], (canvas.left, canvas.top), strict=True)
    )
    return lambda top, end: view_kernel.over(sheet, across, down, picture, top, end)


def _seen(layer: Layer, camera: Camera, picture: Tensor) -> Cover:
    """Any layer."""
    (p, q), (x, y) = camera.view_points(), camera.pixels()
    rows, columns = _reached(layer, camera)

    def cover(top: int, end: int) -> None:
        top, end = max(top, rows.start), min(end, rows.stop)
        if top < end and columns.start < columns.stop:
            rgba = layer.seen(p, q, x[..., columns], y[:, top:end]).unflatten(0, camera.grid)
            picture[..., top:end, columns].mul_(1 - rgba[:, :, 3:]).add_(rgba[:, :, :3])

    return cover


def _reached(layer: Layer, camera: Camera) -> tuple[slice, slice]:
    """Rows and columns where any view may see the layer."""
    canvas, farthest = layer.bitmap.canvas, max(map(abs, _span(layer, camera)))
    spans = [
        _within(first / OVERSAMPLING, (first + count) / OVERSAMPLING, farthest * (n_views - 1) / 2 + 1, length)
        for first, count, n_views, length in (
            (canvas.top, canvas.height, camera.grid[0], camera.size[0]),
            (canvas.left, canvas.width, camera.grid[1], camera.size[1]),
        )
    ]
    return spans[0], spans[1]


def _within(first: float, last: float, reach: float, length: int) -> slice:
    """Pixels of an axis from `reach` before one position to `reach` behind another, both from the centre."""
    centre = (length - 1) / 2
    return slice(max(0, math.floor(first - reach + centre)), min(length, math.ceil(last + reach + centre) + 1))
