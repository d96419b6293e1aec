"""Pictures of layers whose rays are followed one by one, from a grid of aperture points: the compiled loops.

Pictures that face the camera are read as `shift_loop` reads them, row by row and by the same functions, so that the
results are the same to the last bit; others by cubic look-ups. Letters: as in `ray_loop`, `v u` row and column of
aperture points, `y` row of pixels.
"""

from typing import NamedTuple

import numpy as np

from lfref.functional.jit import compiled, inlined
from lfref.simulator.rays import ray_loop
from lfref.simulator.rays.ray_loop import Atlas, Reals, Row, Sights, Wide
from lfref.simulator.reading import look_loop, shift_loop
from lfref.simulator.reading.shift_loop import Shifts


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
def over(sights: Sights, atlas: Atlas, points: Viewpoints, picture: Reals, top: int, end: int) -> None:
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
                    ray_loop.lay(rgba, begin, stop, picture[v, u, :, y])


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
                ray_loop.lay_ranked(rgba, at[:, 2], order, picture[v, u, :, y])


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
    return np.zeros((len(atlas.frames), 4, 2, columns // 2 + 2 * shift_loop.PAD), atlas.samples.dtype)


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
                shift_loop.lay_lines(samples, first, points.down.weights[n, v], 0, columns // 2, lines[n])


@compiled
def _see(
    sights: Sights, atlas: Atlas, points: Viewpoints, k: int, u: int, row: Row, lines: Reals, at: Wide, rgba: Reals,
    extra: Reals,
) -> tuple[int, int]:  # fmt: skip
    """What a row of pixels sees of a layer: `at` as by `ray_loop.meet`, and RGBA; first pixel, one past the last."""
    begin, stop = ray_loop.reached(sights, k, row, rgba.shape[1])
    if begin >= stop:
        return 0, 0
    ray_loop.meet(sights, k, row, begin, stop, at)
    if sights.faces[k]:
        _shift(atlas, points, sights.pictures[k, 0], u, begin, stop, lines, rgba)
    else:
        _look(atlas, sights.pictures[k, 0], begin, stop, at, rgba)
    _legalise(sights.hides[k], begin, stop, rgba)
    if sights.lobes[k, 3] > 0:
        ray_loop.shine(sights, k, row, begin, stop, at, rgba)
    if sights.pictures[k, 1] >= 0:
        _shift(atlas, points, sights.pictures[k, 1], u, begin, stop, lines, extra)
        _reflect(rgba.dtype.type(sights.mirrors[k, 0]), extra, begin, stop, rgba)
    return begin, stop


@compiled
def _shift(atlas: Atlas, points: Viewpoints, n: int, u: int, begin: int, stop: int, lines: Reals, rgba: Reals) -> None:
    """Read the lines of a picture that faces the camera."""
    start, weights = points.across.starts[n, u], points.across.weights[n, u]
    left, right = shift_loop.read_span(start, 0, atlas.frames[n, 2] // 2, rgba.shape[1])
    for c in range(4):
        rgba[c, begin:left] = 0
        rgba[c, right:stop] = 0
        shift_loop.put(lines[n, c], start, weights, max(left, begin), max(min(right, stop), left, begin), rgba[c])


@compiled
def _look(atlas: Atlas, n: int, begin: int, stop: int, at: Wide, rgba: Reals) -> None:
    """Read another picture ray by ray."""
    frame = atlas.frames[n]
    for x in range(begin, stop):
        i, j = ray_loop.sample_position(frame, at[0, x], at[1, x])
        rgba[0, x], rgba[1, x], rgba[2, x], rgba[3, x] = look_loop.cubic(
            atlas.samples, frame[0], frame[1], frame[2], i, j
        )


@compiled
def _legalise(hides: bool, begin: int, stop: int, rgba: Reals) -> None:
    one, zero = rgba.dtype.type(1), rgba.dtype.type(0)
    if hides:
        rgba[3, begin:stop] = 1
    for c in range(3):
        for x in range(begin, stop):
            rgba[c, x] = shift_loop.legal(rgba[c, x], rgba[3, x])
    for x in range(begin, stop):
        rgba[3, x] = min(max(rgba[3, x], zero), one)


@compiled
def _reflect(share: float, mirrored: Reals, begin: int, stop: int, rgba: Reals) -> None:
    zero = rgba.dtype.type(0)
    for c in range(3):
        for x in range(begin, stop):
            rgba[c, x] += share * rgba[3, x] * max(mirrored[c, x], zero)
