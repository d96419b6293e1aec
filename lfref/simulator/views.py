"""Pictures of layers whose rays are followed one by one, from a grid of aperture points: the compiled loops.

Pictures that face the camera are read as `shift_loop` reads them, row by row and by the same functions, so that the
results are the same to the last bit; others by cubic look-ups. Letters: as in `ray_loop`, `v u` row and column of
aperture points, `y` row of pixels.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref import geometry
from lfref.functional import threads
from lfref.functional.jit import compiled, inlined
from lfref.simulator import layers as extents
from lfref.simulator import lookups, rays, shifts
from lfref.simulator import shifts as shift_loop
from lfref.simulator import shifts as shift_tables
from lfref.simulator.blurs import Bitmap
from lfref.simulator.canvases import OVERSAMPLING, Canvas
from lfref.simulator.layers import Layer, layer_rays
from lfref.simulator.rays import Atlas, Page, Reals, Row, Sights, Wide
from lfref.simulator.scene import Camera
from lfref.simulator.shifts import Shifts


class Viewpoints(NamedTuple):
    """Points of the aperture."""

    p: Wide
    """Columns, [U]."""
    q: Wide
    """Rows, [V]."""
    slope: float
    """Of the plane that the pictures are registered on."""
    across: Shifts
    """For the columns, of each picture of an atlas, [N, U] and [N, U, 4]."""
    down: Shifts
    """For the rows, [N, V] and [N, V, 4]."""


@compiled
def over_of_ray_views_loop(
    sights: Sights, atlas: Atlas, points: Viewpoints, picture: Reals, top: int, end: int
) -> None:
    """Lay layers over the rows from `top` to before `end` of all pictures, one after the other.

    Args:
        sights: The layers.
        atlas: Their pictures: planar [4, h, w] where they face the camera.
        points: Of the aperture.
        picture: What is farther; changed, [V, U, 3, H, W].
        top: First row.
        end: One past the last row.
    """
    at = np.empty((5, picture.shape[4]))
    rgba, extra = np.empty((2, 4, picture.shape[4]), picture.dtype)
    lines = _room_for_lines(atlas)
    for y in range(top, end):
        for v in range(points.q.size):
            _lay_lines(sights, atlas, points, v, y, lines)
            for u in range(points.p.size):
                for k in range(len(sights.forms)):
                    row = _row(points, u, v, y, picture)
                    begin, stop = _see(sights, atlas, points, k, u, row, lines, at, rgba, extra)
                    rays.lay(rgba, begin, stop, picture[v, u, :, y])


@compiled
def over_ranked(sights: Sights, atlas: Atlas, points: Viewpoints, picture: Reals, top: int, end: int) -> None:
    """Fill these rows with layers that are sorted at every pixel; arguments as for `over`."""
    n_layers, width = len(sights.forms), picture.shape[4]
    at = np.zeros((n_layers, 5, width))
    rgba = np.zeros((n_layers, 4, width), picture.dtype)
    extra, order = np.empty((4, width), picture.dtype), np.empty(n_layers, np.int64)
    lines = _room_for_lines(atlas)
    for y in range(top, end):
        for v in range(points.q.size):
            _lay_lines(sights, atlas, points, v, y, lines)
            for u in range(points.p.size):
                row = _row(points, u, v, y, picture)
                for k in range(n_layers):
                    begin, stop = _see(sights, atlas, points, k, u, row, lines, at[k], rgba[k], extra)
                    rgba[k, :, :begin] = 0
                    rgba[k, :, stop:] = 0
                rays.lay_ranked(rgba, at[:, 2], order, picture[v, u, :, y])


@inlined
def _row(points: Viewpoints, u: int, v: int, y: int, picture: Reals) -> Row:
    """Rays that stand for a point of the aperture alone."""
    p, q, slope = points.p[u], points.q[v], points.slope
    x, y = slope * p - (picture.shape[4] - 1) / 2, y + slope * q - (picture.shape[3] - 1) / 2
    return Row(p, q, x, y, slope, 0.0)


@compiled
def _room_for_lines(atlas: Atlas) -> Reals:
    """Room for a line of every picture, [N, 4, 2, columns / 2 + padding]."""
    columns = atlas.frames[:, 2].max()
    return np.zeros((len(atlas.frames), 4, 2, columns // 2 + 2 * shifts.PAD), atlas.samples.dtype)


@compiled
def _lay_lines(sights: Sights, atlas: Atlas, points: Viewpoints, v: int, y: int, lines: Reals) -> None:
    """One line of each picture that faces the camera, for all columns of aperture points."""
    for k in range(len(sights.forms)):
        for place in range(0 if sights.faces[k] else 1, 2):
            n = sights.pictures[k, place]
            if n >= 0:
                start, rows, columns = atlas.frames[n, 0], atlas.frames[n, 1], atlas.frames[n, 2]
                samples = atlas.samples[start : start + 4 * rows * columns].reshape(4, rows, columns)
                first = points.down.starts[n, v] + 2 * y
                shifts.lay_lines(samples, first, points.down.weights[n, v], 0, columns // 2, lines[n])


@compiled
def _see(
    sights: Sights, atlas: Atlas, points: Viewpoints, k: int, u: int, row: Row, lines: Reals, at: Wide, rgba: Reals,
    extra: Reals,
) -> tuple[int, int]:  # fmt: skip
    """What a row of pixels sees of a layer: `at` as by `ray_loop.meet`, and RGBA; first pixel, one past the last."""
    begin, stop = rays.reached(sights, k, row, rgba.shape[1])
    if begin >= stop:
        return 0, 0
    rays.meet(sights, k, row, begin, stop, at)
    if sights.faces[k]:
        _shift(atlas, points, sights.pictures[k, 0], u, begin, stop, lines, rgba)
    else:
        _look(atlas, sights.pictures[k, 0], begin, stop, at, rgba)
    _legalise(sights.hides[k], begin, stop, rgba)
    if sights.lobes[k, 3] > 0:
        rays.shine(sights, k, row, begin, stop, at, rgba)
    if sights.pictures[k, 1] >= 0:
        _shift(atlas, points, sights.pictures[k, 1], u, begin, stop, lines, extra)
        _reflect(rgba.dtype.type(sights.mirrors[k, 0]), extra, begin, stop, rgba)
    return begin, stop


@compiled
def _shift(atlas: Atlas, points: Viewpoints, n: int, u: int, begin: int, stop: int, lines: Reals, rgba: Reals) -> None:
    """Read the lines of a picture that faces the camera."""
    start, weights = points.across.starts[n, u], points.across.weights[n, u]
    left, right = shifts.read_span(start, 0, atlas.frames[n, 2] // 2, rgba.shape[1])
    for c in range(4):
        rgba[c, begin:left] = 0
        rgba[c, right:stop] = 0
        shifts.put(lines[n, c], start, weights, max(left, begin), max(min(right, stop), left, begin), rgba[c])


@compiled
def _look(atlas: Atlas, n: int, begin: int, stop: int, at: Wide, rgba: Reals) -> None:
    """Read another picture ray by ray."""
    frame = atlas.frames[n]
    for x in range(begin, stop):
        i, j = rays.sample_position(frame, at[0, x], at[1, x])
        rgba[0, x], rgba[1, x], rgba[2, x], rgba[3, x] = lookups.cubic_of_look_loop(
            atlas.samples, frame[0], frame[1], frame[2], i, j
        )


@compiled
def _legalise(hides: bool, begin: int, stop: int, rgba: Reals) -> None:
    one, zero = rgba.dtype.type(1), rgba.dtype.type(0)
    if hides:
        rgba[3, begin:stop] = 1
    for c in range(3):
        for x in range(begin, stop):
            rgba[c, x] = shifts.legal(rgba[c, x], rgba[3, x])
    for x in range(begin, stop):
        rgba[3, x] = min(max(rgba[3, x], zero), one)


@compiled
def _reflect(share: float, mirrored: Reals, begin: int, stop: int, rgba: Reals) -> None:
    zero = rgba.dtype.type(0)
    for c in range(3):
        for x in range(begin, stop):
            rgba[c, x] += share * rgba[3, x] * max(mirrored[c, x], zero)


# PART layer_by_layer
# Views made in bands of rows, one layer after the other laid over the band: on the CPU the fastest way.
#
# Layers of which all views are shifted copies are carried along whole rows; the rays to others are followed one by one.
# Threads are plain ones, started for the call, as in shift-and-sum: they work after a fork.
# Letters: as in `render`.

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
    boxes = [rays.box(pictures[place], CUBIC) for place, _ in places]
    sights, atlas = rays.sights(layers, spans, boxes, places), rays.atlas(pictures)
    across, down = (Shifts(*map(np.stack, zip(*axis, strict=True))) for axis in zip(*shifts, strict=True))
    aperture = Viewpoints(points.p, points.q, points.slope, across, down)
    over = over_of_ray_views_loop if len(layers) == 1 else over_ranked
    return lambda top, end: over(sights, atlas, aperture, points.picture, top, end)


def _picture(bitmap: Bitmap, faces: bool) -> Page:
    """A bitmap as loops want it: planar where it faces the camera."""
    samples = (bitmap.samples if faces else bitmap.interleaved).numpy()
    return Page(samples, bitmap.samples[3].numpy(), bitmap.canvas.top, bitmap.canvas.left)


# PART render
# Pictures of painted layers: far to near, each over what is behind it.
#
# Letters: `p q` aperture point in view steps, `x y` pixel from the picture's centre, `M` aperture points, `K` layers,
# `D` disparity that a pixel sees.


def composite(rgba: Sequence[Tensor]) -> Tensor:
    """What is seen of layers one in front of the other, on black.

    Args:
        rgba: Premultiplied colours and opacity of each from far to near, [M, 4, H, W].

    Returns:
        Radiance, [M, 3, H, W].
    """
    picture = rgba[0][:, :3]
    for nearer in rgba[1:]:
        picture = nearer[:, :3] + picture * (1 - nearer[:, 3:])
    return picture


def radiance(layers: Sequence[Layer], p: Tensor, q: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Light that reaches pixels through aperture points.

    Args:
        layers: From far to near.
        p: Columns of the aperture points, in view steps from the centre, [M].
        q: Rows of the aperture points, [M].
        x: Columns of pixels from the picture's centre, of a shape that goes with [M, H, W].
        y: Rows of pixels, likewise.

    Returns:
        [M, 3, H, W], float32.
    """
    rgba = [layer.seen(p, q, x, y) for layer in layers]
    if any(layer.is_sorted for layer in layers):
        rgba = nearest_last(rgba, met(layers, *layer_rays(p, q, x, y, layers[0].device)))
    return composite(rgba)


def met(layers: Sequence[Layer], p: Tensor, q: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Disparity that rays meet of each layer, [K, M, H, W]; rays as from `layers.rays`."""
    shape = torch.broadcast_shapes(p.shape, q.shape, x.shape, y.shape)
    return torch.stack([layer.surface.geometry.met_at(x, y, p, q).expand(shape) for layer in layers])


def nearest_last(rgba: Sequence[Tensor], depths: Tensor) -> list[Tensor]:
    """Layers in the order of their disparity at each pixel.

    Args:
        rgba: Of each layer, [M, 4, H, W].
        depths: Disparity that each pixel sees of each layer, [K, M, H, W].
    """
    order = depths.argsort(dim=0, stable=True)[:, :, None].expand(-1, -1, 4, -1, -1)
    return list(torch.stack(list(rgba)).gather(0, order))


def views(layers: Sequence[Layer], camera: Camera) -> Tensor:
    """Pictures from all view points.

    Args:
        layers: From far to near.
        camera: The grid and size of the views.

    Returns:
        Radiance, float32, [V, U, 3, H, W].
    """
    q, p = (geometry.angular_offsets(n_views) for n_views in camera.grid)
    return render_views(layers, camera, p, q)


def render_views(layers: Sequence[Layer], camera: Camera, p: Tensor, q: Tensor, slope: float = 0.0) -> Tensor:
    """Pictures from a grid of aperture points.

    Args:
        layers: From far to near, painted for a reach of |slope|.
        camera: The size of the pictures.
        p: Columns of the aperture points, in view steps from the centre, float64, [U].
        q: Rows of the aperture points, likewise, [V].
        slope: In pixels per view step, of the plane that is at the same place in all pictures.

    Returns:
        Radiance, float32, [V, U, 3, H, W].
    """
    if layers[0].device.type == "cpu":
        return pictures(layers, camera, p, q, slope)
    x, y = camera.pixels()
    across = x + slope * p[:, None, None]
    return torch.stack([radiance(layers, p, row.expand(len(p)), across, y + slope * row) for row in q])


# PART central
# What the central view shows, through a pinhole: where surfaces stand, and how much of each is seen.
#
# Letters: `K` surfaces, in the order of the scene's list.

SEEN = 0.5  # opacity from which a surface is what a pixel shows


def all_in_focus(layers: Sequence[Layer], camera: Camera) -> Tensor:
    """The central view, linear and without what the sensor does, float32, [3, H, W].

    Args:
        layers: From far to near.
        camera: What looks at them.
    """
    return views(layers, replace(camera, grid=(1, 1)))[0, 0]


def disparity(layers: Sequence[Layer], camera: Camera) -> Tensor:
    """Disparity of the nearest surface that each pixel shows, float32, [H, W]; 0 where there is none.

    Args:
        layers: From far to near.
        camera: What looks at them.
    """
    opacities, met = _seen(layers, camera)
    nearest = torch.where(opacities > SEEN, met, -torch.inf).amax(0)
    return torch.where(nearest.isfinite(), nearest, 0.0).float()


def masks(layers: Sequence[Layer], camera: Camera, n_surfaces: int) -> Tensor:
    """Share of each surface in what a pixel shows, float32, [K, H, W]; they leave to 1 what shows nothing.

    Args:
        layers: From far to near.
        camera: What looks at them.
        n_surfaces: Of the scene; those that no layer shows have a share of 0.
    """
    opacities, met = _seen(layers, camera)
    ranks = torch.arange(len(layers), dtype=met.dtype, device=met.device)[:, None, None]
    depths = met if any(layer.is_sorted for layer in layers) else ranks
    shares = opacities.new_zeros(n_surfaces, *camera.size)
    for k, layer in enumerate(layers):
        lead = depths - depths[k]
        is_before = (lead > 0) | ((lead == 0) & (ranks > k))
        shares[layer.place] = opacities[k] * (1 - is_before * opacities).prod(0)
    return shares


def _seen(layers: Sequence[Layer], camera: Camera) -> tuple[Tensor, Tensor]:
    """Opacities, float32, and disparities, float64, of layers in the central view, [K, H, W] each."""
    x, y = (pixels[0].to(layers[0].device) for pixels in camera.pixels())
    # Its rays meet all surfaces at their own (x, y), where bitmaps have samples.
    bitmaps = [Bitmap(layer.bitmap.canvas, layer.bitmap.samples[3:]) for layer in layers]
    opacities = torch.stack([bitmap.window(camera.size)[0, ::OVERSAMPLING, ::OVERSAMPLING] for bitmap in bitmaps])
    met = [layer.surface.geometry.disparity_at(x, y).expand(camera.size) for layer in layers]
    return opacities.clamp(0, 1), torch.stack(met)
