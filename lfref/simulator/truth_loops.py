"""The compiled loops of the truth: layers composited through every cell of the aperture.

A row of the picture is finished before the next one begins. Layers that every cell only shifts are read along whole
rows, interpolated once for all cells of a row of cells; the rays to others are followed one by one.
Letters: `k` layer from far to near, `c` channel of premultiplied RGBA, `j i` row and column of cells, `y x` pixel.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import compiled, inlined
from lfref.simulator import lookups, rays
from lfref.simulator.lookups import Quadruple
from lfref.simulator.rays import Atlas, Reals, Row, Sights, Wide

# PART ray_truth_loop
# The truth of layers whose rays are followed one by one: the compiled loops, with linear look-ups of blurred copies.
#
# Letters: as in `ray_loop`; `e` relative slope, the way of a point of a layer in pixels per view step.


class Levels(NamedTuple):
    """How much each layer is blurred where it is out of focus."""

    places: Wide
    """Picture to read, counted from the layer's first one, with fractions, at even steps of |e| from 0 on, [K, T]."""
    steps: Wide
    """Steps for each unit of |e|, [K]."""


@compiled
def see(sights: Sights, levels: Levels, atlas: Atlas, k: int, row: Row, at: Wide, rgba: Reals) -> tuple[int, int]:
    """What a row of pixels sees of a layer through a cell.

    Args:
        sights: The layers.
        levels: Their blurs.
        atlas: Their pictures.
        k: Which.
        row: The rays.
        at: Filled where the layer is seen as by `ray_loop.meet`, [5, W].
        rgba: Likewise with premultiplied colours and opacity, [4, W].

    Returns:
        First pixel at which it may be seen, and one past the last.
    """
    begin, stop = rays.reached(sights, k, row, rgba.shape[1])
    if begin >= stop:
        return 0, 0
    rays.meet(sights, k, row, begin, stop, at)
    _read(sights.pictures[k, 0], levels.places[k], levels.steps[k], atlas, row.slope, begin, stop, at, rgba)
    if sights.lobes[k, 3] > 0:
        rays.shine(sights, k, row, begin, stop, at, rgba)
    if sights.pictures[k, 1] >= 0:
        _reflect(sights, atlas, k, row, begin, stop, rgba)
    return begin, stop


@compiled
def _read(
    first: int, places: Wide, steps: float, atlas: Atlas, slope: float, begin: int, stop: int, at: Wide, rgba: Reals
) -> None:
    for x in range(begin, stop):
        step = abs(slope - at[2, x]) * steps
        below = min(int(step), places.size - 2)
        place = places[below] + (step - below) * (places[below + 1] - places[below])
        level = int(place)
        share = rgba.dtype.type(place - level)
        red, green, blue, opacity = _linear(atlas, first + level, at[0, x], at[1, x])
        if share > 0:
            wide = _linear(atlas, first + level + 1, at[0, x], at[1, x])
            red += share * (wide[0] - red)
            green += share * (wide[1] - green)
            blue += share * (wide[2] - blue)
            opacity += share * (wide[3] - opacity)
        rgba[0, x], rgba[1, x], rgba[2, x], rgba[3, x] = red, green, blue, opacity


@compiled
def _reflect(sights: Sights, atlas: Atlas, k: int, row: Row, begin: int, stop: int, rgba: Reals) -> None:
    share, disparity = rgba.dtype.type(sights.mirrors[k, 0]), sights.mirrors[k, 1]
    for x in range(begin, stop):
        at_x, at_y = row.x + x - disparity * row.p, row.y - disparity * row.q
        red, green, blue, _ = _linear(atlas, sights.pictures[k, 1], at_x, at_y)
        light = share * rgba[3, x]
        rgba[0, x] += light * red
        rgba[1, x] += light * green
        rgba[2, x] += light * blue


@inlined
def _linear(atlas: Atlas, n: int, at_x: float, at_y: float) -> Quadruple:
    """A picture at a point."""
    frame = atlas.frames[n]
    i, j = rays.sample_position(frame, at_x, at_y)
    return lookups.linear_of_look_loop(atlas.samples, frame[0], frame[1], frame[2], i, j)


# PART smooth_loop
# The compiled filters of layers that every cell of the aperture only shifts.
#
# A layer's samples lie phase by phase: of `o` samples a pixel, sample m = o x + f is column x of phase f, so that a row
# of pixels reads contiguous memory wherever it starts.
# Letters: `k` layer from far to near, `c` channel of premultiplied RGBA, `y x` pixel, `m` row of samples, `t` tap.

Integers = NDArray[np.int64]
SmoothLoopReals = NDArray[np.floating]


class Smoothed(NamedTuple):
    """Layers that are seen together, from far to near."""

    samples: SmoothLoopReals
    """Premultiplied RGBA, blurred by a cell, [K, 4, rows, o, columns]."""
    first: Integers
    """First column of a row that is not transparent, [K, rows]."""
    last: Integers
    """One past the last such column, [K, rows]."""


@compiled
def smooth(
    samples: SmoothLoopReals,
    down: SmoothLoopReals,
    across: SmoothLoopReals,
    result: SmoothLoopReals,
    first: Integers,
    last: Integers,
) -> None:
    """Filter a layer along both axes where it is not transparent, and sort its columns by phase.

    Args:
        samples: Premultiplied RGBA, its ends going on beyond it, [4, rows, columns].
        down: Taps along a column, symmetric, odd in number.
        across: Taps along a row, symmetric, odd in number.
        result: Filled, [4, rows, o, columns / o].
        first: Filled: first column of each row that is not transparent, [rows].
        last: Filled: one past the last such column, [rows].
    """
    n_phases, n_columns = result.shape[2:]
    side, half = across.size // 2, down.size // 2
    begins, ends = _seen_spans(samples[3])
    row = np.zeros(samples.shape[2] + 2 * side + n_phases, samples.dtype)
    line = np.zeros((n_phases, row.size // n_phases), samples.dtype)
    for m in range(samples.shape[1]):
        near = slice(max(m - half, 0), m + half + 1)
        begin, end = begins[near].min(), ends[near].max()
        result[:, m] = 0
        first[m], last[m] = max(begin - side, 0) // n_phases, min((end + side - 1) // n_phases + 1, n_columns)
        if begin >= end:
            first[m] = last[m] = 0
            continue
        for c in range(4):
            _filter_down(samples[c], m, down, begin, end, side, row)
            _sort(row, line, first[m])
            for f in range(n_phases):
                target = result[c, m, f, first[m] : last[m]]
                for t in range(across.size):
                    start = first[m] + (f + t) // n_phases
                    _accumulate(across[t], line[(f + t) % n_phases, start : start + target.size], target)


@compiled
def _seen_spans(opacity: SmoothLoopReals) -> tuple[Integers, Integers]:
    """First column of each row that is not transparent, and one past the last; [rows] each."""
    n_rows, n_columns = opacity.shape
    begins, ends = np.full(n_rows, n_columns), np.zeros(n_rows, np.int64)
    for m in range(n_rows):
        x = 0
        while x < n_columns and opacity[m, x] == 0:
            x += 1
        begins[m] = x
        end = n_columns
        while end > x and opacity[m, end - 1] == 0:
            end -= 1
        ends[m] = end if end > x else 0
    return begins, ends


@compiled
def _filter_down(
    samples: SmoothLoopReals, m: int, down: SmoothLoopReals, begin: int, end: int, side: int, row: SmoothLoopReals
) -> None:
    """Row m of the filtered samples from column `begin` to before `end`, continued by `side` at both ends."""
    row[:] = 0
    target = row[side + begin : side + end]
    for t in range(down.size):
        source = min(max(m + t - down.size // 2, 0), samples.shape[0] - 1)
        _accumulate(down[t], samples[source, begin:end], target)
    if begin == 0:
        row[:side] = row[side]
    if end == samples.shape[1]:
        row[side + end :] = row[side + end - 1]


@compiled
def _sort(row: SmoothLoopReals, line: SmoothLoopReals, first: int) -> None:
    """Columns of each phase side by side, from pixel column `first` on."""
    n_phases = line.shape[0]
    for f in range(n_phases):
        target = line[f]
        for x in range(first, target.size):
            target[x] = row[x * n_phases + f]


@compiled
def pick(
    samples: SmoothLoopReals,
    down: SmoothLoopReals,
    across: SmoothLoopReals,
    top: int,
    left: int,
    n_phases: int,
    result: SmoothLoopReals,
) -> None:
    """Add a filter's values at pixels.

    Args:
        samples: [C, h, w].
        down: Taps along a column.
        across: Taps along a row.
        top: Row of samples that the first tap reads for the first pixel.
        left: Likewise the column.
        n_phases: Samples a pixel.
        result: Changed, [C, H, W].
    """
    row = np.zeros(samples.shape[2], samples.dtype)
    line = np.zeros((n_phases, samples.shape[2] // n_phases), samples.dtype)
    width = result.shape[2]
    for y in range(result.shape[1]):
        for c in range(samples.shape[0]):
            row[:] = 0
            for t in range(down.size):
                _accumulate(down[t], samples[c, top + y * n_phases + t], row)
            _sort(row, line, 0)
            for t in range(across.size):
                start = (left + t) // n_phases
                _accumulate(across[t], line[(left + t) % n_phases, start : start + width], result[c, y])


@compiled
def _accumulate(weight: float, values: SmoothLoopReals, row: SmoothLoopReals) -> None:
    share = row.dtype.type(weight)
    for x in range(row.size):
        row[x] += share * values[x]


class Places(NamedTuple):
    """Where each layer is read, in samples, for pixel 0."""

    rows: SmoothLoopReals
    """For each row of cells, >= 0, float64, [K, J]."""
    columns: SmoothLoopReals
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

    p: SmoothLoopReals
    """Columns of their middles in view steps, float64, [I]."""
    q: SmoothLoopReals
    """Rows, float64, [J]."""
    weights: SmoothLoopReals
    """Share of each, of sum 1, float64, [J, I]."""
    cell: float
    """Width of one."""
    slope: float
    """Of the plane."""


@compiled
def add_shifted(
    shifted: Smoothed, positions: Places, through: Through, picture: SmoothLoopReals, top: int, end: int
) -> None:
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
    shifted: Smoothed,
    positions: Places,
    followed: Followed,
    through: Through,
    picture: SmoothLoopReals,
    top: int,
    end: int,
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
                            rays.lay(rgba, begin, stop, sight)
                    _add(through.weights[j, i], sight, total)
        picture[:, y] = total


@compiled
def add_sorted(followed: Followed, through: Through, picture: SmoothLoopReals, top: int, end: int) -> None:
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
                    rays.lay_shared(rgba, at, followed.crosses, row, shares, sight)
                    _add(through.weights[j, i], sight, total)
        picture[:, y] = total


@compiled
def _see(followed: Followed, k: int, row: Row, at: SmoothLoopReals, rgba: SmoothLoopReals) -> tuple[int, int]:
    return see(followed.sights, followed.levels, followed.atlas, k, row, at, rgba)


@inlined
def _row(through: Through, i: int, j: int, y: int, picture: SmoothLoopReals) -> Row:
    """The rays through the middle of a cell to a row of pixels."""
    p, q, slope = through.p[i], through.q[j], through.slope
    x = slope * p - (picture.shape[2] - 1) / 2
    return Row(p, q, x, y + slope * q - (picture.shape[1] - 1) / 2, slope, through.cell)


@compiled
def _room_for_lines(shifted: Smoothed) -> tuple[SmoothLoopReals, Integers]:
    """Room for a row of every layer, and for where it is not transparent."""
    n_layers, n_phases, n_columns = shifted.samples.shape[0], shifted.samples.shape[3], shifted.samples.shape[4]
    lines = np.zeros((n_layers, 4, n_phases, n_columns), shifted.samples.dtype)
    return lines, np.zeros((n_layers, 2), np.int64)


@compiled
def _read_lines(shifted: Smoothed, positions: Places, j: int, y: int, lines: SmoothLoopReals, spans: Integers) -> None:
    for k in range(len(lines)):
        _read_line(shifted, k, positions.rows[k, j] + y * lines.shape[2], lines[k], spans[k])


@compiled
def _read_line(layers: Smoothed, k: int, position: float, line: SmoothLoopReals, span: Integers) -> None:
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
def _cover(line: SmoothLoopReals, position: float, span: Integers, sight: SmoothLoopReals) -> None:
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
def _add(weight: float, sight: SmoothLoopReals, total: SmoothLoopReals) -> None:
    for c in range(3):
        for x in range(sight.shape[1]):
            total[c, x] += weight * sight[c, x]
