"""The compiled loops of the truth: layers composited through every cell of the aperture.

One row of the picture after the other: for each cell, the layers are laid over one another from far to near in a row of
radiance, which is added to the total with the cell's weight. Layers that every cell only shifts are read along whole
rows, interpolated between two rows of samples once for all cells of a row of cells. The rays to other layers are
followed one by one, with linear look-ups of a blurred window.
A blurred layer's samples lie phase by phase: of `o` samples per pixel, sample m = o x + f is column x of phase f. A row
of pixels then reads contiguous memory wherever it starts. Neighbouring rays to a slanted surface mostly read
neighbouring columns, too: the loops look for such runs of pixels.
Letters: `k` layer from far to near, `c` channel of premultiplied RGBA, `j i` row and column of cells, `y x` pixel,
`m` row of samples, `f` phase, `t` tap, `e` relative slope in pixels per view step.
"""

from typing import NamedTuple

import numpy as np

from lfref.functional.loops import compiled, inlined
from lfref.simulator import rays
from lfref.simulator.bitmaps import CopyBlur, Floats
from lfref.simulator.rays import Atlas, Bools, Float64s, Integers, RayLayers, RayRow


class ApertureCells(NamedTuple):
    """Cells of the aperture through which a plane is seen."""

    p: Float64s  # columns of their centres in view steps, [I]
    q: Float64s  # rows of their centres, [J]
    weights: Float64s  # share of the open aperture in each cell, [J, I]; their sum is 1
    width: float  # width of one cell in view steps
    slope: float  # slope of the plane in pixels per view step


class BlurredLayers(NamedTuple):
    """Layers that every cell only shifts, from far to near."""

    samples: Floats  # premultiplied RGBA, blurred by a cell, [K, 4, rows, o, columns]
    first: Integers  # first column that is not transparent in each row, [K, rows]
    last: Integers  # one past the last such column, [K, rows]


class CellPositions(NamedTuple):
    """Position where pixel 0 reads each shifted layer, in samples, at least 0."""

    rows: Float64s  # row of samples through each row of cells, [K, J]
    columns: Float64s  # column of samples through each column of cells, [K, I]


class LookUps(NamedTuple):
    """Where the pixels of a row read a window."""

    keys: Integers  # row of samples, and column less `o` times the pixel; the same in a run of pixels, [W]
    across: Floats  # share of the next column, [W]
    down: Floats  # share of the next row, [W]


class TracedLayers(NamedTuple):
    """Layers whose rays are followed one by one."""

    layers: RayLayers
    windows: Atlas  # blurred windows, phase by phase: [4, rows, o, columns] each
    order: Integers  # layers from far to near: index among shifted layers, or -1 - index among traced layers
    crosses: Bools  # pairs of layers that cross, [K, K]


@compiled
def composite_fixed(
    shifted: BlurredLayers, positions: CellPositions, traced: TracedLayers, cells: ApertureCells, picture: Floats,
    top: int, end: int,
) -> None:  # fmt: skip
    """Fill the rows from `top` to before `end` of a picture [3, H, W], for layers in a fixed order from far to near."""
    n_layers, n_phases, n_columns = shifted.samples.shape[0], shifted.samples.shape[3], shifted.samples.shape[4]
    lines = np.zeros((n_layers, 4, n_phases, n_columns), shifted.samples.dtype)
    spans = np.zeros((n_layers, 2), np.int64)
    # The total is float64: thousands of cells are added up.
    radiance, total = np.zeros((3, picture.shape[2]), picture.dtype), np.zeros((3, picture.shape[2]))
    rgba, at = np.zeros((4, picture.shape[2]), picture.dtype), np.zeros((5, picture.shape[2]))
    look_ups = _look_ups(picture)
    for y in range(top, end):
        total[:] = 0
        for j in range(cells.q.size):
            # The row of each layer that these pixels read through row j of cells.
            for k in range(n_layers):
                _interpolate_line(shifted, k, positions.rows[k, j] + y * n_phases, lines[k], spans[k])
            for i in range(cells.p.size):
                # Cells outside of a disc are shut.
                if cells.weights[j, i] > 0:
                    # From far to near, each layer dims what is behind it and adds its own light.
                    radiance[:] = 0
                    for k in traced.order:
                        if k >= 0:
                            _composite_line(lines[k], positions.columns[k, i], spans[k], radiance)
                        else:
                            row = rays.rays_of_row(cells.p[i], cells.q[j], cells.slope, cells.width, y, picture)
                            begin, stop = trace_row(traced.layers, traced.windows, -1 - k, row, look_ups, at, rgba)
                            rays.composite_over(rgba, begin, stop, radiance)
                    _add_weighted(cells.weights[j, i], radiance, total)
        picture[:, y] = total


@compiled
def composite_sorted(traced: TracedLayers, cells: ApertureCells, picture: Floats, top: int, end: int) -> None:
    """Fill rows of a picture for layers that cross: all rays are followed, and layers sorted at every pixel."""
    n_layers, width = len(traced.order), picture.shape[2]
    radiance, total = np.zeros((3, width), picture.dtype), np.zeros((3, width))
    rgba, at = np.zeros((n_layers, 4, width), picture.dtype), np.zeros((n_layers, 5, width))
    passed, look_ups = np.empty(width, picture.dtype), _look_ups(picture)
    for y in range(top, end):
        total[:] = 0
        for j in range(cells.q.size):
            for i in range(cells.p.size):
                if cells.weights[j, i] > 0:
                    row = rays.rays_of_row(cells.p[i], cells.q[j], cells.slope, cells.width, y, picture)
                    for k in range(n_layers):
                        begin, stop = trace_row(traced.layers, traced.windows, k, row, look_ups, at[k], rgba[k])
                        # Outside these pixels the layer is transparent; with opacity 0, old values of `at` do no harm.
                        rgba[k, :, :begin] = 0
                        rgba[k, :, stop:] = 0
                    rays.composite_crossing(rgba, at, traced.crosses, row, passed, radiance)
                    _add_weighted(cells.weights[j, i], radiance, total)
        picture[:, y] = total


@compiled
def _add_weighted(weight: float, radiance: Floats, total: Floats) -> None:
    for c in range(3):
        for x in range(radiance.shape[1]):
            total[c, x] += weight * radiance[c, x]


# Shifted layers: blurred once for each plane, then read row by row.


@compiled
def blur_layer(samples: Floats, down: Floats, across: Floats, result: Floats, first: Integers, last: Integers) -> None:
    """Filter a layer [4, rows, columns] along both axes, edge samples repeated, and sort its columns by phase.

    Taps are symmetric and odd in number. The loop fills `result` [4, rows, o, columns / o], and, for each row, `first`
    and `last`: the first column of pixels that is not transparent, and one past the last.
    """
    n_phases, n_columns = result.shape[2:]
    side, half = across.size // 2, down.size // 2
    begins, ends = _visible_spans(samples[3])
    row = np.zeros(samples.shape[2] + 2 * side + n_phases, samples.dtype)
    line = np.zeros((n_phases, row.size // n_phases), samples.dtype)
    for m in range(samples.shape[1]):
        # Each row is filtered down the columns into `row`, sorted by phase into `line`, and filtered along into
        # `result`. A filtered row is visible where any row under the taps is, and `side` samples further.
        near = slice(max(m - half, 0), m + half + 1)
        begin, end = begins[near].min(), ends[near].max()
        result[:, m] = 0
        first[m], last[m] = max(begin - side, 0) // n_phases, min((end + side - 1) // n_phases + 1, n_columns)
        if begin >= end:
            first[m] = last[m] = 0
            continue
        for c in range(4):
            _filter_down(samples[c], m, down, begin, end, side, row)
            _sort_by_phase(row, line, first[m])
            # Sample o x + f + t of the padded row is column x + (f + t) // o of phase (f + t) % o.
            for f in range(n_phases):
                target = result[c, m, f, first[m] : last[m]]
                for t in range(across.size):
                    start = first[m] + (f + t) // n_phases
                    _accumulate(across[t], line[(f + t) % n_phases, start : start + target.size], target)


@compiled
def _visible_spans(opacity: Floats) -> tuple[Integers, Integers]:
    """First column that is not transparent and one past the last such column, of each row, [rows] each."""
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
def _filter_down(samples: Floats, m: int, down: Floats, begin: int, end: int, side: int, row: Floats) -> None:
    """Fill `row` with filtered row m, from column `begin` to before `end`, padded by `side` columns at both ends."""
    row[:] = 0
    target = row[side + begin : side + end]
    for t in range(down.size):
        source = min(max(m + t - down.size // 2, 0), samples.shape[0] - 1)
        _accumulate(down[t], samples[source, begin:end], target)
    # Edge samples of the bitmap repeat beyond it; edge samples of the visible part do not.
    if begin == 0:
        row[:side] = row[side]
    if end == samples.shape[1]:
        row[side + end :] = row[side + end - 1]


@compiled
def _sort_by_phase(row: Floats, line: Floats, first: int) -> None:
    """Put the columns of each phase side by side, from pixel column `first` on."""
    n_phases = line.shape[0]
    for f in range(n_phases):
        target = line[f]
        for x in range(first, target.size):
            target[x] = row[x * n_phases + f]


@compiled
def filter_at_pixels(
    samples: Floats, down: Floats, across: Floats, top: int, left: int, n_phases: int, result: Floats
) -> None:
    """Add a separable filter's values at pixels to `result` [C, H, W]; samples are [C, h, w].

    The first tap of the first pixel reads `top` and `left`, those of further pixels `n_phases` samples further on.
    """
    row = np.zeros(samples.shape[2], samples.dtype)
    line = np.zeros((n_phases, samples.shape[2] // n_phases), samples.dtype)
    width = result.shape[2]
    for y in range(result.shape[1]):
        for c in range(samples.shape[0]):
            row[:] = 0
            for t in range(down.size):
                _accumulate(down[t], samples[c, top + y * n_phases + t], row)
            _sort_by_phase(row, line, 0)
            for t in range(across.size):
                start = (left + t) // n_phases
                _accumulate(across[t], line[(left + t) % n_phases, start : start + width], result[c, y])


@compiled
def _accumulate(weight: float, values: Floats, row: Floats) -> None:
    share = row.dtype.type(weight)
    for x in range(row.size):
        row[x] += share * values[x]


@compiled
def _interpolate_line(shifted: BlurredLayers, k: int, position: float, line: Floats, span: Integers) -> None:
    """Fill `line` with layer k at any height, linearly between two rows, and `span` with its visible columns."""
    m = int(position)
    share = line.dtype.type(position - m)
    rest = line.dtype.type(1) - share
    below = min(m + 1, shifted.samples.shape[2] - 1)
    span[0] = min(shifted.first[k, m], shifted.first[k, below])
    span[1] = max(shifted.last[k, m], shifted.last[k, below])
    if span[0] >= span[1]:
        return
    for c in range(4):
        upper, lower = shifted.samples[k, c, m], shifted.samples[k, c, below]
        for f in range(line.shape[1]):
            target, a, b = line[c, f], upper[f], lower[f]
            for x in range(span[0], span[1]):
                target[x] = rest * a[x] + share * b[x]
            target[: span[0]] = 0
            target[span[1] :] = 0


@compiled
def _composite_line(line: Floats, position: float, span: Integers, radiance: Floats) -> None:
    """Lay a row of a layer, [4, o, columns], over the radiance [3, W] behind it; pixel 0 reads `position`.

    Pixel x reads linearly between samples m + o x and m + 1 + o x: columns p + x and q + x of the phases f and g of
    samples m and m + 1.
    """
    n_phases, width = line.shape[1], radiance.shape[1]
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
    # Slices that all start at 0: the compiler can vectorise the loop over them.
    a0, a1, a2, a3 = line[0, f, p : p + n], line[1, f, p : p + n], line[2, f, p : p + n], line[3, f, p : p + n]
    b0, b1, b2, b3 = line[0, g, q : q + n], line[1, g, q : q + n], line[2, g, q : q + n], line[3, g, q : q + n]
    s0, s1, s2 = radiance[0, begin:stop], radiance[1, begin:stop], radiance[2, begin:stop]
    for x in range(n):
        passed = one - (rest * a3[x] + share * b3[x])
        s0[x] = rest * a0[x] + share * b0[x] + passed * s0[x]
        s1[x] = rest * a1[x] + share * b1[x] + passed * s1[x]
        s2[x] = rest * a2[x] + share * b2[x] + passed * s2[x]


# Traced layers: a window is mixed of blurred copies for each plane, and read where rays meet the surface.


@compiled
def add_copy(
    copy: Floats, frame: tuple[int, int], level: int, form: Float64s, blur: CopyBlur, corner: tuple[int, int],
    window: Floats, top: int, end: int,
) -> None:  # fmt: skip
    """Add a copy's share to rows `top` to before `end` of a window, [4, rows, o, columns].

    A surface's disparity, and with it the blur that a plane needs, depends on the point of the surface only: between
    two levels, their copies are mixed. Beyond the copy [h, w, 4] its edge samples repeat. `frame` and `corner` are Y
    and X of the first sample of the copy and of the window, in samples; `form` has the parameters of `surfaces.Form`.
    """
    n_phases, n_columns = window.shape[2:]
    shares = np.empty((n_phases, n_columns), window.dtype)
    columns = np.empty((n_phases, n_columns), np.int64)
    for f in range(n_phases):
        for x in range(n_columns):
            columns[f, x] = min(max(x * n_phases + f + corner[1] - frame[1], 0), copy.shape[1] - 1)
    for m in range(top, end):
        at_y = (m + corner[0]) / n_phases
        offset_y = (at_y - form[6]) / form[4] if form[3] != 0 else 0.0
        is_read = False
        for f in range(n_phases):
            for x in range(n_columns):
                at_x = x + (f + corner[1]) / n_phases
                disparity = form[0] + form[1] * at_x + form[2] * at_y
                if form[3] != 0:
                    offset_x = (at_x - form[5]) / form[4]
                    rise = max(1 - offset_x * offset_x - offset_y * offset_y, 0.0)
                    disparity += form[3] * rise * rise
                step = max(abs(blur.slope - disparity), blur.nearest) * blur.steps
                below = min(int(step), blur.levels.size - 2)
                share = min(step - below, 1.0)
                wanted = blur.levels[below] + share * (blur.levels[below + 1] - blur.levels[below])
                shares[f, x] = max(1 - abs(wanted - level), 0.0)
                is_read |= shares[f, x] > 0
        if is_read:
            source = copy[min(max(m + corner[0] - frame[0], 0), copy.shape[0] - 1)]
            for f in range(n_phases):
                for x in range(n_columns):
                    share = shares[f, x]
                    for c in range(4):
                        window[c, m, f, x] += share * source[columns[f, x], c]


@inlined
def _look_ups(picture: Floats) -> LookUps:
    width = picture.shape[2]
    return LookUps(np.zeros(width, np.int64), np.zeros(width, picture.dtype), np.zeros(width, picture.dtype))


@compiled
def trace_row(
    layers: RayLayers, windows: Atlas, k: int, row: RayRow, look_ups: LookUps, at: Float64s, rgba: Floats
) -> tuple[int, int]:
    """Fill `at` and `rgba` [4, W] with traced layer k at a row of pixels; returns the first and one past the last."""
    begin, stop = rays.visible_pixels(layers, k, row, rgba.shape[1])
    if begin >= stop:
        return 0, 0
    rays.intersect(layers, k, row, begin, stop, at)
    _find_samples(windows, layers.bitmaps[k, 0], at, begin, stop, look_ups)
    _read_runs(windows, layers.bitmaps[k, 0], begin, stop, look_ups, rgba)
    if layers.highlights[k, 3] > 0:
        rays.add_highlight(layers, k, row, begin, stop, at, rgba)
    if layers.bitmaps[k, 1] >= 0:
        share, disparity = rgba.dtype.type(layers.mirrors[k, 0]), layers.mirrors[k, 1]
        mirrored, points = np.empty_like(rgba), np.empty((2, rgba.shape[1]))
        for x in range(begin, stop):
            points[0, x], points[1, x] = row.x + x - disparity * row.p, row.y - disparity * row.q
        _find_samples(windows, layers.bitmaps[k, 1], points, begin, stop, look_ups)
        _read_runs(windows, layers.bitmaps[k, 1], begin, stop, look_ups, mirrored)
        for c in range(3):
            for x in range(begin, stop):
                rgba[c, x] += share * rgba[3, x] * mirrored[c, x]
    return begin, stop


@compiled
def _find_samples(windows: Atlas, n: int, at: Float64s, begin: int, stop: int, look_ups: LookUps) -> None:
    """Fill the look-ups of window n at points, X and Y in `at` [2 or more, W]; beyond it, its edge repeats."""
    _, rows, columns, top, left = windows.frames[n]
    for x in range(begin, stop):
        i = min(max(at[0, x] * windows.density - left, 0.0), columns - 1.0)
        j = min(max(at[1, x] * windows.density - top, 0.0), rows - 1.0)
        column, line = min(int(i), columns - 2), min(int(j), rows - 2)
        look_ups.across[x], look_ups.down[x] = i - column, j - line
        look_ups.keys[x] = (line << 32) + column - windows.density * x


@compiled
def _read_runs(windows: Atlas, n: int, begin: int, stop: int, look_ups: LookUps, rgba: Floats) -> None:
    """Fill `rgba` [4, W] with linear look-ups of window n, run by run."""
    start, rows, n_samples, _, _ = windows.frames[n]
    n_phases = windows.density
    n_columns = n_samples // n_phases
    first = begin
    while first < stop:
        end = first + 1
        while end < stop and look_ups.keys[end] == look_ups.keys[first]:
            end += 1
        length = end - first
        flat = look_ups.keys[first] + n_phases * first
        line = flat >> 32
        m = flat - (line << 32)
        p, q = (m % n_phases) * n_columns + m // n_phases, ((m + 1) % n_phases) * n_columns + (m + 1) // n_phases
        across, down = look_ups.across[first:end], look_ups.down[first:end]
        for c in range(4):
            at = start + (c * rows + line) * n_samples
            a, b = windows.samples[at + p : at + p + length], windows.samples[at + q : at + q + length]
            at += n_samples
            u, v = windows.samples[at + p : at + p + length], windows.samples[at + q : at + q + length]
            target = rgba[c, first:end]
            for x in range(length):
                upper = a[x] + across[x] * (b[x] - a[x])
                lower = u[x] + across[x] * (v[x] - u[x])
                target[x] = upper + down[x] * (lower - upper)
        first = end
