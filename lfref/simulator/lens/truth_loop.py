"""The compiled loops of the truth: layers composited through every cell of the aperture.

A row of the picture is finished before the next one begins. Layers that every cell only shifts are read along whole
rows, interpolated once for all cells of a row of cells; the rays to others are followed one by one.
Letters: `k` layer from far to near, `c` channel of premultiplied RGBA, `j i` row and column of cells, `y x` pixel.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import compiled, inlined
from lfref.simulator.lens import ray_truth_loop
from lfref.simulator.lens.ray_truth_loop import Levels
from lfref.simulator.lens.smooth_loop import Integers, Reals, Smoothed
from lfref.simulator.rays import ray_loop
from lfref.simulator.rays.ray_loop import Atlas, Row, Sights


class Places(NamedTuple):
    """Where each layer is read, in samples, for pixel 0."""

    rows: Reals
    """For each row of cells, >= 0, float64, [K, J]."""
    columns: Reals
    """For each column of cells, >= 0, float64, [K, I]."""


class Followed(NamedTuple):
    """Layers whose rays are followed one by one."""

    sights: Sights
    levels: Levels
    atlas: Atlas
    order: Integers
    """Of all layers from far to near: place among those read along rows, or -1 - place among those followed."""
    crosses: NDArray[np.bool_]
    """Pairs of layers that cross, [K, K]."""


class Through(NamedTuple):
    """Cells of the aperture that a plane is seen through."""

    p: Reals
    """Columns of their middles in view steps, float64, [I]."""
    q: Reals
    """Rows, float64, [J]."""
    weights: Reals
    """Share of each, of sum 1, float64, [J, I]."""
    cell: float
    """Width of one."""
    slope: float
    """Of the plane."""


@compiled
def add_shifted(shifted: Smoothed, positions: Places, through: Through, picture: Reals, top: int, end: int) -> None:
    """Composite the rows from `top` to before `end` of a picture through every cell.

    Args:
        shifted: Layers, all read along whole rows.
        positions: Where they are seen through each cell.
        through: The cells.
        picture: Filled in these rows, [3, H, W].
        top: First row.
        end: One past the last row.
    """
    lines, spans = _room_for_lines(shifted)
    sight, total = np.zeros((3, picture.shape[2]), picture.dtype), np.zeros((3, picture.shape[2]))
    for y in range(top, end):
        total[:] = 0
        for j in range(through.q.size):
            _read_lines(shifted, positions, j, y, lines, spans)
            for i in range(through.p.size):
                if through.weights[j, i] > 0:
                    sight[:] = 0
                    for k in range(len(lines)):
                        _cover(lines[k], positions.columns[k, i], spans[k], sight)
                    _add(through.weights[j, i], sight, total)
        picture[:, y] = total


@compiled
def add_mixed(
    shifted: Smoothed, positions: Places, followed: Followed, through: Through, picture: Reals, top: int, end: int
) -> None:
    """The same, where the rays to some layers are followed; arguments as for `add_shifted`, and these layers."""
    lines, spans = _room_for_lines(shifted)
    sight, total = np.zeros((3, picture.shape[2]), picture.dtype), np.zeros((3, picture.shape[2]))
    rgba, at = np.zeros((4, picture.shape[2]), picture.dtype), np.zeros((5, picture.shape[2]))
    for y in range(top, end):
        total[:] = 0
        for j in range(through.q.size):
            _read_lines(shifted, positions, j, y, lines, spans)
            for i in range(through.p.size):
                if through.weights[j, i] > 0:
                    sight[:] = 0
                    for k in followed.order:
                        if k >= 0:
                            _cover(lines[k], positions.columns[k, i], spans[k], sight)
                        else:
                            row = _row(through, i, j, y, picture)
                            begin, stop = _see(followed, -1 - k, row, at, rgba)
                            ray_loop.lay(rgba, begin, stop, sight)
                    _add(through.weights[j, i], sight, total)
        picture[:, y] = total


@compiled
def add_sorted(followed: Followed, through: Through, picture: Reals, top: int, end: int) -> None:
    """The same, where the rays to all layers are followed and layers sorted at every pixel; arguments as above."""
    n_layers, width = len(followed.order), picture.shape[2]
    sight, total = np.zeros((3, width), picture.dtype), np.zeros((3, width))
    rgba, at = np.zeros((n_layers, 4, width), picture.dtype), np.zeros((n_layers, 5, width))
    shares = np.empty(width, picture.dtype)
    for y in range(top, end):
        total[:] = 0
        for j in range(through.q.size):
            for i in range(through.p.size):
                if through.weights[j, i] > 0:
                    row = _row(through, i, j, y, picture)
                    for k in range(n_layers):
                        begin, stop = _see(followed, k, row, at[k], rgba[k])
                        rgba[k, :, :begin] = 0
                        rgba[k, :, stop:] = 0
                    ray_loop.lay_shared(rgba, at, followed.crosses, row, shares, sight)
                    _add(through.weights[j, i], sight, total)
        picture[:, y] = total


@compiled
def _see(followed: Followed, k: int, row: Row, at: Reals, rgba: Reals) -> tuple[int, int]:
    return ray_truth_loop.see(followed.sights, followed.levels, followed.atlas, k, row, at, rgba)


@inlined
def _row(through: Through, i: int, j: int, y: int, picture: Reals) -> Row:
    """The rays through the middle of a cell to a row of pixels."""
    p, q, slope = through.p[i], through.q[j], through.slope
    x = slope * p - (picture.shape[2] - 1) / 2
    return Row(p, q, x, y + slope * q - (picture.shape[1] - 1) / 2, slope, through.cell)


@compiled
def _room_for_lines(shifted: Smoothed) -> tuple[Reals, Integers]:
    """Room for a row of every layer, and for where it is not transparent."""
    n_layers, n_phases, n_columns = shifted.samples.shape[0], shifted.samples.shape[3], shifted.samples.shape[4]
    lines = np.zeros((n_layers, 4, n_phases, n_columns), shifted.samples.dtype)
    return lines, np.zeros((n_layers, 2), np.int64)


@compiled
def _read_lines(shifted: Smoothed, positions: Places, j: int, y: int, lines: Reals, spans: Integers) -> None:
    for k in range(len(lines)):
        _read_line(shifted, k, positions.rows[k, j] + y * lines.shape[2], lines[k], spans[k])


@compiled
def _read_line(layers: Smoothed, k: int, position: float, line: Reals, span: Integers) -> None:
    """Row of a layer at any height, between the two next to it."""
    m = int(position)
    share = line.dtype.type(position - m)
    rest = line.dtype.type(1) - share
    below = min(m + 1, layers.samples.shape[2] - 1)
    span[0] = min(layers.first[k, m], layers.first[k, below])
    span[1] = max(layers.last[k, m], layers.last[k, below])
    if span[0] >= span[1]:
        return
    for c in range(4):
        upper, lower = layers.samples[k, c, m], layers.samples[k, c, below]
        for f in range(line.shape[1]):
            target, a, b = line[c, f], upper[f], lower[f]
            for x in range(span[0], span[1]):
                target[x] = rest * a[x] + share * b[x]
            target[: span[0]] = 0
            target[span[1] :] = 0


@compiled
def _cover(line: Reals, position: float, span: Integers, sight: Reals) -> None:
    """Lay a row of a layer over what is seen so far."""
    n_phases, width = line.shape[1], sight.shape[1]
    m = int(position)
    share = line.dtype.type(position - m)
    one = line.dtype.type(1)
    rest = one - share
    f, g = m % n_phases, (m + 1) % n_phases
    p, q = m // n_phases, (m + 1) // n_phases
    begin, stop = max(0, span[0] - q), min(width, span[1] - p)
    if span[0] >= span[1] or begin >= stop:
        return
    n = stop - begin
    p, q = p + begin, q + begin
    a0, a1, a2, a3 = line[0, f, p : p + n], line[1, f, p : p + n], line[2, f, p : p + n], line[3, f, p : p + n]
    b0, b1, b2, b3 = line[0, g, q : q + n], line[1, g, q : q + n], line[2, g, q : q + n], line[3, g, q : q + n]
    s0, s1, s2 = sight[0, begin:stop], sight[1, begin:stop], sight[2, begin:stop]
    for x in range(n):
        passed = one - (rest * a3[x] + share * b3[x])
        s0[x] = rest * a0[x] + share * b0[x] + passed * s0[x]
        s1[x] = rest * a1[x] + share * b1[x] + passed * s1[x]
        s2[x] = rest * a2[x] + share * b2[x] + passed * s2[x]


@compiled
def _add(weight: float, sight: Reals, total: Reals) -> None:
    for c in range(3):
        for x in range(sight.shape[1]):
            total[c, x] += weight * sight[c, x]
