"""Shift-and-sum on the CPU at the speed of its caches: compiled loops that read each source row once for every plane.

`add_band` takes four steps for a source row y of one line of views:

1. `_gather` copies the rows of the line's views one after the other, as floating point, continued beyond both ends.
   Where no conversion is needed and every tap that counts lies on its view, rows are read in place instead.
2. `_sum_row` adds up the horizontally shifted views for a plane, in passes over the whole row; `_sum_edge` then sums
   again, tap by tap, the columns at both ends that not all views serve.
3. `_add` adds this sum, weighted, to the output rows that it lies between: a ring of unfinished rows for each plane.
4. An output row is written out once, when the last source row that it reads has passed.

So the source rows of a line, one row of sums and the rings stay in the first two caches. The tables say which samples
each plane reads with which weights; they depend on slopes and sizes only, so the last ones are kept. Threads are plain
ones, started for the call: they work after a fork, and are as many as PyTorch's.
It is kept beside `by_torch` for its time, measured on 7x7x3x375x540 views and 16 planes with two threads: 21
(cubic), 32 (linear) and 44 times (nearest) less than PyTorch's operations.
Letters: `n` plane, `v u` line of views and view in it, `c` channel, `y x` source row and column, `r` output row, `k`
tap; `G` groups of `TAPS` taps, `R` lines of taps: 1 where all lines of views stand at the same columns, else V.
"""

import functools
import itertools
import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.functional import loops
from lfref.functional.loops import compiled, compiling, inlined
from lfref.refocus import batches, footprint
from lfref.refocus.footprint import RowFactors
from lfref.refocus.sampling import (
    TAPS,
    Border,
    Integers,
    Interpolation,
    Reals,
    add_taps,
    rounded_up,
    set_taps,
)
from lfref.refocus.shift.shifts import Shifts, combined


class Plan(NamedTuple):
    """The planes to be summed; equal plans are one key of a cache. N planes, R lines of views, M views in each."""

    rows: tuple[tuple[float, ...], ...]
    """Vertical shift of each line in pixels, [N, R]."""
    columns: tuple[tuple[tuple[float, ...], ...], ...]
    """Horizontal shift of each view of a line, [N, R, M]; [N, 1, M] if all lines are alike."""
    widths: tuple[float, ...]
    """Width of the box that blurs each sum, in pixels, [N]; 0: none."""
    aperture: tuple[tuple[float, ...], ...]
    """Weight of each view, of sum 1, by lines, [R, M]."""
    size: tuple[int, int]
    """Height and width of a view in pixels."""
    interpolation: Interpolation
    border: Border

    @property
    def is_separable(self) -> bool:
        """Whether all lines have their views at the same columns."""
        return all(len(columns) == 1 for columns in self.columns)

    @property
    def reach(self) -> int:
        """Samples beyond the edge that may be read."""
        lines = (*self.rows, *(line for plane in self.columns for line in plane))
        return math.ceil(max(abs(shift) for line in lines for shift in line)) + max(1, self.interpolation.before)

    def shifts(self, n: int) -> Shifts:
        """Those of plane n as tensors."""
        rows, columns, widths = (
            torch.tensor([own[n]], dtype=torch.float64) for own in (self.rows, self.columns, self.widths)
        )
        return Shifts(
            rows, columns, footprint.taps(widths, footprint.radius(self.widths[n])) if self.widths[n] > 0 else None
        )


class ViewMemory(NamedTuple):
    """Views where they lie in memory, and what continues them beyond their edges."""

    samples: NDArray
    """Memory of the views, any type, one axis."""
    direct: Reals
    """This memory if rows can be read in place; else empty."""
    starts: Integers
    """`Horizontal.starts` for rows read in place, from `reach` samples before the first view's row, [N, R, G, TAPS]."""
    last: int
    """Last position in `direct` from which all taps stay within the memory; -1: none."""
    strides: Integers
    """Steps in it along v, u, c, y, x."""
    n_columns: int
    """Views in a line."""
    rows: Integers
    """Source row at each position from -reach to H + reach; -1: black, [H + 2 reach]."""
    columns: Integers
    """Source column at each position from -reach to W + reach; -1: black, filled up to whole vectors, [...]."""
    reach: int
    """Samples beyond the edge that are read."""
    width: int
    """W, columns of a view."""


class Horizontal(NamedTuple):
    """Taps of the horizontal pass, `TAPS` at a time in G groups; those of weight 0 fill up the last group."""

    starts: Integers
    """Position in the rows of a line (one after the other) that each tap reads for the first column, [N, R, G,
    TAPS]."""
    weights: Reals
    """[N, V, G, TAPS]."""
    groups: Integers
    """Groups in use, [N]."""
    begins: Integers
    """First column that each tap serves, [N, R, G, TAPS]."""
    ends: Integers
    """One past the last column that each tap serves, [N, R, G, TAPS]."""
    left: Integers
    """First column that all taps serve, [N, R]."""
    right: Integers
    """One past the last column that all taps serve, [N, R]."""


class Vertical(NamedTuple):
    """Taps of the vertical pass: source row y serves row y - offset of the planes."""

    offsets: Integers
    """[N, V, M]."""
    weights: Reals
    """[N, V, M]."""
    begins: Integers
    """First output row that each line of views serves, [N, V]."""
    ends: Integers
    """One past the last output row that each line of views serves, [N, V]."""
    lowest: Integers
    """Least offset, [N]."""
    highest: Integers
    """Greatest offset, [N]."""


class Tables(NamedTuple):
    """All that the loops need beside the views."""

    rows: NDArray
    """As in `ViewMemory`."""
    columns: NDArray
    """As in `ViewMemory`."""
    across: Horizontal
    down: Vertical
    scale: RowFactors
    """Factors of the sums, [N, kinds, width], and kinds, [N, height], of the planes."""
    blurred: list[RowFactors]
    """Factors of the planes when they are blurred, [N]."""


class RowBuffers(NamedTuple):
    """Memory of one thread."""

    rows: Reals
    """The source rows of a line, continued beyond their ends, [U, ...]."""
    total: Reals
    """One row of sums, [width rounded up]."""
    ring: Reals
    """Unfinished output rows, used in turn, those of all planes one after the other."""
    first: Integers
    """First row of each plane in the ring, and the end, [N + 1]."""


def shift_and_sum(
    views: Tensor,
    shifts: Shifts,
    widths: Tensor | None,
    aperture: Tensor,
    interpolation: Interpolation,
    border: Border,
) -> Tensor:
    """The sums [B, N, C, H, W] of shifted views [B, R, M, C, H, W], over the weight of those that count.

    They are blurred by boxes of some widths [N]; the aperture [R, M] is of sum 1.
    """
    boxes = torch.zeros(len(shifts.rows)) if widths is None else widths
    rows, columns, weights = (part.tolist() for part in (shifts.rows, shifts.columns, aperture))
    plan = Plan(
        tuple(map(tuple, rows)),
        tuple(tuple(map(tuple, plane)) for plane in columns),
        tuple(boxes.tolist()),
        tuple(map(tuple, weights)),
        (views.shape[-2], views.shape[-1]),
        interpolation,
        border,
    )
    samples = (views if views.dtype in batches.FULL_SCALE else batches.radiance(views)).detach().numpy()
    working = np.dtype(np.float64 if views.dtype == torch.float64 else np.float32)
    tables = _tables(plan, working, batches.FULL_SCALE.get(views.dtype, 1))
    # NumPy asks the system for large pages, which are far cheaper to touch for the first time.
    stack = np.empty((len(views), len(plan.rows), views.shape[3], *plan.size), working)
    sources = [_memory(field, tables, plan) for field in samples]
    n_threads = loops.worthwhile(stack.size, 1 << 18)  # samples from which one more thread pays
    first = np.concatenate([[0], np.cumsum(tables.down.highest - tables.down.lowest + 1)])

    def refocus(index: int, band: tuple[int, int]) -> None:
        width = rounded_up(plan.size[1])
        buffers = RowBuffers(
            rows=np.zeros((len(plan.aperture[0]), len(tables.columns)), working),
            total=np.empty(width, working),
            ring=np.zeros((first[-1], width), working),
            first=first,
        )
        add_band(sources[index], tables.across, tables.down, tables.scale, buffers, stack[index], *band)

    jobs = itertools.product(range(len(views)), loops.bands(plan.size[0], n_threads))
    loops.share(refocus, jobs, n_threads)
    if any(plan.widths):
        footprint.box_planes(stack, plan.widths, plan.border, tables.blurred)
    return torch.from_numpy(stack)


def _memory(field: NDArray, tables: Tables, plan: Plan) -> ViewMemory:
    """One light field [V, U, C, H, W] as the memory that it spans."""
    across, row_length = tables.across, len(tables.columns)
    strides = np.array(field.strides, np.int64) // field.itemsize
    span = 1 + int((strides * (np.array(field.shape) - 1)).sum())
    memory = np.lib.stride_tricks.as_strided(field, (span,), (field.itemsize,))
    # Rows are read in place if every tap lies on its view wherever it counts; those of a cubic reach beyond.
    offsets, counts = across.starts % row_length - plan.reach, across.begins < across.ends
    is_on_view = (across.begins + offsets >= 0) & (across.ends + offsets <= plan.size[1])
    direct, starts, last = np.empty(0, across.weights.dtype), across.starts, -1
    if field.dtype == direct.dtype and strides[4] == 1 and bool((is_on_view | ~counts).all()):
        u, position = np.divmod(starts, row_length)
        direct, starts = memory, position + u * strides[1]
        last = span - int(starts.max()) - rounded_up(plan.size[1])
    return ViewMemory(
        memory, direct, starts, last, strides, field.shape[1], tables.rows, tables.columns, plan.reach, plan.size[1]
    )


@functools.lru_cache(maxsize=16)
def _tables(plan: Plan, working: np.dtype, full_scale: int) -> Tables:
    (height, width), n_planes = plan.size, len(plan.rows)
    own = [_factors(plan, n) for n in range(n_planes)]
    # A plane that is blurred is divided by its coverage after that, not before.
    scale = np.zeros((n_planes, max(len(each.factors) for each in own), width), working)
    kinds = np.zeros((n_planes, height), np.int64)
    for n, (each, box) in enumerate(zip(own, plan.widths, strict=True)):
        scale[n, : len(each.factors)] = (1.0 if box > 0 else each.factors) / full_scale
        kinds[n] = 0 if box > 0 else each.kinds
    rows, columns = (plan.border.indices(plan.reach, length).numpy() for length in plan.size)
    columns = np.concatenate([columns, np.full(rounded_up(width) - width, -1)])
    return Tables(
        rows,
        columns,
        _horizontal(plan, columns.size, working),
        _vertical(plan, working),
        RowFactors(scale, kinds),
        [RowFactors(each.factors.astype(working), each.kinds) for each in own],
    )


def _factors(plan: Plan, n: int) -> RowFactors:
    """One over the weight of the samples that count in plane n."""
    if not plan.border.counts_only_samples:
        return RowFactors(np.ones((1, plan.size[1])), np.zeros(plan.size[0], np.int64))
    shifts, aperture = plan.shifts(n), torch.tensor(plan.aperture, dtype=torch.float64)
    rows, columns = shifts.sampled(plan.size)
    blurred = shifts.blurred(rows, plan.border)
    # Rows that the same lines have a sample in, and around them, are of one kind: they share their factors.
    _, first, kinds = np.unique(
        torch.cat([rows[0], blurred[0]]).numpy(), axis=1, return_index=True, return_inverse=True
    )
    covered = combined(rows[..., first], columns, aperture)
    share = combined(blurred[..., first], shifts.blurred(columns, plan.border), aperture)
    return RowFactors(footprint.inverse(covered, share)[0].numpy(), kinds)


def _horizontal(plan: Plan, row_length: int, working: np.dtype) -> Horizontal:
    aperture, width, reach = np.array(plan.aperture), plan.size[1], plan.reach
    parts = [aperture] if plan.is_separable else np.split(aperture, len(aperture))
    # The taps (u, start, weight, columns served) of every plane and line, without views and samples of weight 0.
    planes: list[list[list[tuple[int, int, float, tuple[int, int]]]]] = []
    for lines in plan.columns:
        planes.append([])
        for columns, part in zip(lines, parts, strict=True):
            line = []
            for u, shift in enumerate(columns):
                for offset, weight in plan.interpolation.taps(shift) if part[:, u].sum() > 0 else ():
                    if weight != 0:
                        begin, end = plan.border.span(shift, width)
                        line.append((u, u * row_length + reach + offset, weight, (begin, end)))
            planes[-1].append(line)
    groups = np.array([max(-(-len(taps) // TAPS) for taps in plane) for plane in planes])
    shape = (len(planes), len(parts), groups.max(), TAPS)
    starts, begins, ends = (np.zeros(shape, np.int64) for _ in range(3))
    weights = np.zeros((len(planes), len(parts), len(parts[0]), *shape[2:]), working)
    left, right = np.zeros(shape[:2], np.int64), np.full(shape[:2], width)
    for n, r in np.ndindex(shape[:2]):
        taps = planes[n][r]
        # Taps that fill up the last group read what the first tap reads: 0 times a NaN from elsewhere would be NaN.
        starts[n, r] = taps[0][1] if taps else 0
        for k, (u, start, weight, (begin, end)) in enumerate(taps):
            g, i = divmod(k, TAPS)
            starts[n, r, g, i], begins[n, r, g, i], ends[n, r, g, i] = start, begin, end
            weights[n, r, :, g, i] = weight * parts[r][:, u]
        if taps:
            left[n, r] = min(max(begin for *_, (begin, _) in taps), width)
            right[n, r] = max(min(end for *_, (_, end) in taps), left[n, r])
    # One of the two axes that count lines has length 1.
    return Horizontal(starts, weights.reshape(len(planes), -1, *shape[2:]), groups, begins, ends, left, right)


def _vertical(plan: Plan, working: np.dtype) -> Vertical:
    taps = np.array([[plan.interpolation.taps(shift) for shift in rows] for rows in plan.rows])
    is_open = np.array(plan.aperture).sum(axis=1) > 0
    spans = np.array([[plan.border.span(shift, plan.size[0]) for shift in rows] for rows in plan.rows])
    offsets, weights = taps[..., 0].astype(np.int64), (taps[..., 1] * is_open[:, None]).astype(working)
    # Offsets of taps without weight must not lengthen the ring of unfinished rows.
    offsets = np.where(weights != 0, offsets, offsets[:, :1, :1])
    begins, ends = np.ascontiguousarray(spans[..., 0]), np.ascontiguousarray(spans[..., 1])
    return Vertical(offsets, weights, begins, ends, offsets.min((1, 2)), offsets.max((1, 2)))


@compiled
def add_band(
    source: ViewMemory,
    across: Horizontal,
    down: Vertical,
    scale: RowFactors,
    buffers: RowBuffers,
    stack: Reals,
    top: int,
    end: int,
) -> None:
    """Refocus the rows from `top` to before `end` of a stack [N, C, H, W]; the buffers are black before and after."""
    lowest, highest = down.lowest[0], down.highest[0]  # NumPy's `min` would take half a second to compile
    for n in range(1, stack.shape[0]):
        lowest, highest = min(lowest, down.lowest[n]), max(highest, down.highest[n])
    for c in range(stack.shape[1]):
        for y in range(top + lowest, end + highest):
            y_source = source.rows[y + source.reach]
            for v in range(across.weights.shape[1] if y_source >= 0 else 0):
                first = v * source.strides[0] + c * source.strides[2] + y_source * source.strides[3] - source.reach
                if 0 <= first <= source.last:
                    rows, starts = source.direct[first:], source.starts
                else:
                    _gather(source, v, c, y_source, buffers.rows)
                    rows, starts = buffers.rows.reshape(-1), across.starts
                _serve_planes(rows, starts, buffers, v, y, across, down, stack.shape[3], top, end)
            # Source row y was the last one that output row r of plane n reads.
            for n in range(stack.shape[0]):
                r = y - down.highest[n]
                if top <= r < end:
                    row, factors, result = (
                        _unfinished(buffers, n, r),
                        scale.factors[n, scale.kinds[n, r]],
                        stack[n, c, r],
                    )
                    for x in range(result.size):
                        result[x] = row[x] * factors[x]
                    row[:] = 0


@inlined
def _unfinished(buffers: RowBuffers, n: int, r: int) -> Reals:
    return buffers.ring[buffers.first[n] + r % (buffers.first[n + 1] - buffers.first[n])]


@inlined
def _gather(source: ViewMemory, v: int, c: int, y: int, rows: Reals) -> None:
    """Copy row y of the views of line v, continued beyond both ends."""
    strides, columns, reach, width = source.strides, source.columns, source.reach, source.width
    for u in range(source.n_columns):
        first = v * strides[0] + u * strides[1] + c * strides[2] + y * strides[3]
        row, step = rows[u], strides[4]
        if step == 1:  # the compiler makes vectors of this loop only
            line, inner = source.samples[first : first + width], row[reach : reach + width]
            for x in range(width):
                inner[x] = line[x]
        else:
            for x in range(width):
                row[reach + x] = source.samples[first + x * step]
        for x in range(reach):
            row[x] = row[reach + columns[x]] if columns[x] >= 0 else 0
        for x in range(reach + width, row.size):
            row[x] = row[reach + columns[x]] if columns[x] >= 0 else 0


@inlined
def _serve_planes(
    rows: Reals,
    starts: Integers,
    buffers: RowBuffers,
    v: int,
    y: int,
    across: Horizontal,
    down: Vertical,
    width: int,
    top: int,
    end: int,
) -> None:
    """Add source row y of line v to the unfinished output rows of every plane."""
    total, line = buffers.total, v if starts.shape[1] > 1 else 0
    for n in range(buffers.first.size - 1):
        begin, stop = max(top, down.begins[n, v]), min(end, down.ends[n, v])
        is_summed = False
        for m in range(down.offsets.shape[2]):
            r, weight = y - down.offsets[n, v, m], down.weights[n, v, m]
            if begin <= r < stop and weight != 0:
                if not is_summed:  # once for all output rows that it serves
                    _sum_row(rows, starts[n, line], across, n, v, line, total, width)
                    is_summed = True
                _add(weight, total, _unfinished(buffers, n, r))


@compiling(forceinline=True)  # measured: 9 % faster than `inlined`
def _sum_row(
    rows: Reals, starts: Integers, across: Horizontal, n: int, v: int, line: int, total: Reals, width: int
) -> None:
    """The shifted views of one line added up for one plane."""
    weights, begins, ends = across.weights[n, v], across.begins[n, line], across.ends[n, line]
    left, right = across.left[n, line], across.right[n, line]
    set_taps(rows, starts[0], weights[0], total)
    for g in range(1, across.groups[n]):
        add_taps(rows, starts[g], weights[g], total)
    if left > 0:
        _sum_edge(rows, starts, weights, begins, ends, total, 0, left)
    if right < width:
        _sum_edge(rows, starts, weights, begins, ends, total, right, width)


@compiled
def _sum_edge(
    rows: Reals, starts: Integers, weights: Reals, begins: Integers, ends: Integers, total: Reals, left: int, right: int
) -> None:
    """Sum again, tap by tap, the columns from left to right that not every tap serves."""
    for x in range(left, right):
        total[x] = 0
    for g in range(starts.shape[0]):
        for k in range(TAPS):
            weight, start = weights[g, k], starts[g, k]
            for x in range(max(left, begins[g, k]), min(right, ends[g, k])):
                total[x] += weight * rows[start + x]


@compiled
def _add(weight: float, total: Reals, row: Reals) -> None:
    for x in range(total.size):
        row[x] += weight * total[x]
