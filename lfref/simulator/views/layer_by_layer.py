"""Views made in bands of rows, one layer after the other laid over the band: on the CPU the fastest way.

Layers of which all views are shifted copies are carried along whole rows; the rays to others are followed one by one.
Threads are plain ones, started for the call, as in shift-and-sum: they work after a fork.
Letters: as in `render`.
"""

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.functional import threads
from lfref.simulator.canvases import OVERSAMPLING, Canvas
from lfref.simulator.painting import extents
from lfref.simulator.painting.layers import Layer
from lfref.simulator.rays import ray_tables
from lfref.simulator.rays.ray_tables import Page
from lfref.simulator.reading import shift_loop, shift_tables
from lfref.simulator.reading.blurs import Bitmap
from lfref.simulator.reading.shift_loop import Shifts
from lfref.simulator.scene import Camera
from lfref.simulator.views import ray_views_loop

BAND = 8
"""Rows of all views that are finished before the next: they stay in a core's second cache."""
CUBIC = 1.5
"""Pixels around a point that a cubic looks at, and half a pixel for rounding."""

Cover = Callable[[int, int], None]
"""(first row, one past the last row): lays layers over these rows of the picture."""


class Points(NamedTuple):
    """A grid of aperture points, and the picture seen from each."""

    p: NDArray[np.float64]
    """Columns in view steps from the centre, [U]."""
    q: NDArray[np.float64]
    """Rows in view steps from the centre, [V]."""
    slope: float
    """In pixels per view step, of the plane that the pictures are registered on; 0 for views."""
    picture: NDArray[np.float32]
    """Radiance, [V, U, 3, H, W]."""


def pictures(layers: Sequence[Layer], camera: Camera, p: Tensor, q: Tensor, slope: float = 0.0) -> Tensor:
    """Pictures from a grid of aperture points, of layers on the CPU; as `render.pictures`, which hands them on."""
    # Only a plain copy may go over what memory happens to hold.
    make = np.empty if layers[0].hides and not layers[0].is_traced else np.zeros
    picture = make((len(q), len(p), 3, *camera.size), np.float32)
    covers = _covers(layers, camera, Points(p.numpy(), q.numpy(), slope, picture))

    def finish(top: int, end: int) -> None:
        for cover in covers:
            cover(top, end)

    height = camera.size[0]
    threads.share(finish, itertools.pairwise([*range(0, height, BAND), height]), torch.get_num_threads())
    return torch.from_numpy(picture)


def _covers(layers: Sequence[Layer], camera: Camera, points: Points) -> list[Cover]:
    if any(layer.is_sorted for layer in layers):
        return [_followed(layers, camera, points)]
    return [
        _followed([layer], camera, points) if layer.is_traced else _shifted(layer, camera, points) for layer in layers
    ]


def _shifted(layer: Layer, camera: Camera, points: Points) -> Cover:
    """A layer of which all pictures are shifted copies."""
    samples = layer.bitmap.samples.numpy()
    sheet = shift_tables.filled(samples[:3]) if layer.hides else shift_tables.outlined(samples)
    across, down = _shifts(layer.bitmap.canvas, layer.surface.geometry.form.disparity, camera, points)
    return lambda top, end: shift_loop.over(sheet, across, down, points.picture, top, end)


def _shifts(canvas: Canvas, disparity: float, camera: Camera, points: Points) -> tuple[Shifts, Shifts]:
    """How a bitmap that faces the camera is read along rows, and along columns."""
    across, down = (
        shift_tables.shifts((pixels.min() + (points.slope - disparity) * torch.from_numpy(steps)) * OVERSAMPLING - edge)
        for pixels, steps, edge in zip(camera.pixels(), points[:2], (canvas.left, canvas.top), strict=True)
    )
    return across, down


def _followed(layers: Sequence[Layer], camera: Camera, points: Points) -> Cover:
    """Any layers, sorted at each pixel where there are several."""
    pictures: list[Page] = []
    places, shifts = [], []
    for layer in layers:
        geometry, reflection = layer.surface.geometry, layer.reflection
        places.append((len(pictures), len(pictures) + 1 if reflection else -1))
        pictures.append(_picture(layer.bitmap, geometry.is_parallel))
        shifts.append(_shifts(layer.bitmap.canvas, geometry.form.disparity, camera, points))
        if reflection:
            pictures.append(_picture(reflection.picture, True))
            shifts.append(_shifts(reflection.picture.canvas, reflection.disparity, camera, points))
    spans = [extents.span(camera, layer.surface.geometry, abs(points.slope)) for layer in layers]
    boxes = [ray_tables.box(pictures[place], CUBIC) for place, _ in places]
    sights, atlas = ray_tables.sights(layers, spans, boxes, places), ray_tables.atlas(pictures)
    across, down = (Shifts(*map(np.stack, zip(*axis, strict=True))) for axis in zip(*shifts, strict=True))
    aperture = ray_views_loop.Viewpoints(points.p, points.q, points.slope, across, down)
    over = ray_views_loop.over if len(layers) == 1 else ray_views_loop.over_ranked
    return lambda top, end: over(sights, atlas, aperture, points.picture, top, end)


def _picture(bitmap: Bitmap, faces: bool) -> Page:
    """A bitmap as loops want it: planar where it faces the camera."""
    samples = (bitmap.samples if faces else bitmap.interleaved).numpy()
    return Page(samples, bitmap.samples[3].numpy(), bitmap.canvas.top, bitmap.canvas.left)
