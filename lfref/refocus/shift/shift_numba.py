"""The compiled inner loops of shift-and-sum: each source row is read once and serves every plane.

For a row y of the U views of one view row, and for each plane, one pass adds up the horizontally shifted views; the
sum goes, weighted, into the output rows that it lies between. All of that stays in the first two caches: U source rows
as floating point, one row of sums, and a ring of unfinished output rows a plane, written out once when complete.
Source rows that need neither conversion nor what lies beyond their ends are not copied: what a pass reads there is
summed again, by the taps that count.
Letters: `n` plane, `v u` view row and column, `c` channel, `y x` source row and column, `r` output row, `k` tap.
"""

import functools
import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.functional import threads
from lfref.functional.jit import compiled, inlined
from lfref.functional.row_sums import TAPS, add_taps, rounded_up, set_taps
from lfref.refocus import batches
from lfref.refocus import footprint_blur as boxes
from lfref.refocus import footprint_blur as cells
from lfref.refocus.footprint_blur import RowFactors
from lfref.refocus.shift.shift_torch import Shifts, Task

Integers = NDArray[np.int64]
Reals = NDArray[np.floating]


class Source(NamedTuple):
    """Views where they lie in memory, and what continues them beyond their edges."""

    samples: NDArray
    """Memory of the views, any type, one axis."""
    direct: Reals
    """The same where rows can be read as they lie there, neither converted nor continued; else empty."""
    starts: Integers
    """`Horizontal.starts`, but in the views' own rows, counted from `reach` before the first, [N, R, G, TAPS]."""
    last: int
    """Last place in `direct` from which all of these taps stay within it; -1: none."""
    strides: Integers
    """Steps in it along v, u, c, y, x."""
    n_columns: int
    """View columns, U."""
    rows: Integers
    """Source row of each row from -reach to H + reach; -1: black, [H + 2 reach]."""
    columns: Integers
    """The same for columns, the end filled up to whole vectors, [reach + W + reach + ...]."""


class Horizontal(NamedTuple):
    """Taps of the horizontal pass, `TAPS` at a time in G groups; those of weight 0 fill up the last group.

    R is 1 where all view rows stand at the same columns, else V.
    """

    starts: Integers
    """Where in the U rows (one after the other) each tap reads for x = 0, [N, R, G, TAPS]."""
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
    """Taps of the vertical pass: source row y serves output row y - offset."""

    offsets: Integers
    """[N, V, M]."""
    weights: Reals
    """[N, V, M]."""
    begins: Integers
    """First output row that each view row serves, [N, V]."""
    ends: Integers
    """One past the last output row that each view row serves, [N, V]."""
    lowest: Integers
    """Least offset, [N]."""
    highest: Integers
    """Greatest offset, [N]."""
    least: int
    """Least of all offsets."""
    most: int
    """Greatest of all offsets."""


class Scale(NamedTuple):
    """What the sums are multiplied by; rows of one kind share their factors."""

    factors: Reals
    """[N, kinds, W]."""
    kinds: Integers
    """[N, H]."""


class Scratch(NamedTuple):
    """What one thread works in."""

    rows: Reals
    """The U source rows, continued beyond their ends, [U, ...]."""
    total: Reals
    """One row of sums, [W rounded up]."""
    ring: Reals
    """Unfinished output rows, used in turn, those of all planes one after the other."""
    first: Integers
    """Where each plane's begin, and the end, [N + 1]."""


@compiled
def add_band(
    source: Source,
    across: Horizontal,
    down: Vertical,
    scale: Scale,
    scratch: Scratch,
    stack: Reals,
    top: int,
    end: int,
) -> None:
    """Refocus the rows from `top` to before `end` of a stack.

    Args:
        source: The views.
        across: Taps of the horizontal pass.
        down: Taps of the vertical pass.
        scale: Factors of the sums.
        scratch: To work in, black.
        stack: Filled in these rows, [N, C, H, W].
        top: First row.
        end: One past the last row.
    """
    reach = (source.rows.size - stack.shape[2]) // 2
    for c in range(stack.shape[1]):
        for y in range(top + down.least, end + down.most):
            y_source = source.rows[y + reach]
            for v in range(across.weights.shape[1] if y_source >= 0 else 0):
                first = v * source.strides[0] + c * source.strides[2] + y_source * source.strides[3] - reach
                if 0 <= first <= source.last:
                    rows, starts = source.direct[first:], source.starts
                else:
                    _gather(source, v, c, y_source, scratch.rows, reach, stack.shape[3])
                    rows, starts = scratch.rows.reshape(-1), across.starts
                _serve_planes(rows, starts, scratch, v, y, across, down, stack.shape[3], top, end)
            for n in range(stack.shape[0]):
                r = y - down.highest[n]
                if top <= r < end:
                    _finish(_unfinished(scratch, n, r), scale.factors[n, scale.kinds[n, r]], stack[n, c, r])


@inlined
def _unfinished(scratch: Scratch, n: int, r: int) -> Reals:
    return scratch.ring[scratch.first[n] + r % (scratch.first[n + 1] - scratch.first[n])]


@inlined
def _gather(source: Source, v: int, c: int, y: int, rows: Reals, reach: int, width: int) -> None:
    """Copy row y of the views of view row v, continued beyond both ends."""
    strides, columns = source.strides, source.columns
    for u in range(source.n_columns):
        first = v * strides[0] + u * strides[1] + c * strides[2] + y * strides[3]
        row, step = rows[u], strides[4]
        if step == 1:
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
    scratch: Scratch,
    v: int,
    y: int,
    across: Horizontal,
    down: Vertical,
    width: int,
    top: int,
    end: int,
) -> None:
    """Add source row y of view row v to the unfinished output rows of every plane."""
    total, line = scratch.total, v if starts.shape[1] > 1 else 0
    for n in range(scratch.first.size - 1):
        begin, stop = max(top, down.begins[n, v]), min(end, down.ends[n, v])
        is_summed = False
        for m in range(down.offsets.shape[2]):
            r, weight = y - down.offsets[n, v, m], down.weights[n, v, m]
            if begin <= r < stop and weight != 0:
                if not is_summed:
                    _sum_row(rows, starts[n, line], across, n, v, line, total, width)
                    is_summed = True
                _add(weight, total, _unfinished(scratch, n, r))


@inlined
def _sum_row(
    rows: Reals, starts: Integers, across: Horizontal, n: int, v: int, line: int, total: Reals, width: int
) -> None:
    """The shifted views of one view row added up for one plane."""
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
    rows: Reals,
    starts: Integers,
    weights: Reals,
    begins: Integers,
    ends: Integers,
    total: Reals,
    left: int,
    right: int,
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


@compiled
def _finish(row: Reals, factors: Reals, result: Reals) -> None:
    """Write a complete row out, and leave it black for the next use."""
    for x in range(result.size):
        result[x] = row[x] * factors[x]
    row[:] = 0


# PART by_numba
# Shift-and-sum on the CPU at the machine's speed: tables for the compiled loops, and threads that share the rows.
#
# The tables say which samples each plane reads with which weights; they depend on slopes and sizes only, so the last
# ones are kept. Threads are plain ones, started for the call: they work after a fork, and are as many as PyTorch's.
# Letters: `n` plane, `v u` view row and column, `k` tap; others as in `row_loop`.

WORTH_A_THREAD = 1 << 18
"""Samples of a stack from which one more thread saves more than it costs."""


class _Plan(NamedTuple):
    """The tables of a task."""

    rows: NDArray
    """As in `row_loop.Source`."""
    columns: NDArray
    """As in `row_loop.Source`."""
    across: Horizontal
    down: Vertical
    scale: Scale
    blurred: list[RowFactors]
    """What planes are multiplied by when they are blurred, [N]."""


def shift_and_sum(views: Tensor, task: Task, room: Tensor | None = None) -> Tensor:
    """The sums of the shifted views, over the weight of those that count.

    Args:
        views: Light fields on the CPU, floating point (half types are copied to float32), uint8 or uint16, any
            strides, [B, V, U, C, H, W].
        task: What is to be summed, by an interpolation of few taps.
        room: Stacks to write into, contiguous; passed over if they are of another type than the sums.

    Returns:
        Stacks, float32 (float64 for such views), [B, N, C, H, W]; the room given if it could be used.
    """
    samples = (views if views.dtype in batches.FULL_SCALE else batches.radiance(views)).detach().numpy()
    working = np.dtype(np.float64 if views.dtype == torch.float64 else np.float32)
    plan = _plan(task, working, batches.FULL_SCALE.get(views.dtype, 1))
    if room is None or room.dtype != batches.working_dtype(views.dtype):
        # NumPy asks the system for large pages, which are far cheaper to touch for the first time.
        room = torch.from_numpy(np.empty((len(views), len(task.planes), views.shape[3], *task.size), working))
    stack = room.numpy()
    sources = [_source(field, plan, task) for field in samples]
    n_threads = threads.worthwhile(stack.size, WORTH_A_THREAD)

    def refocus(index: int, band: tuple[int, int]) -> None:
        scratch = _new_scratch(plan, task, working)
        add_band(sources[index], plan.across, plan.down, plan.scale, scratch, stack[index], *band)

    jobs = itertools.product(range(len(views)), threads.bands(task.size[0], n_threads))
    threads.share(refocus, jobs, n_threads)
    if task.blurs:
        cells.box_planes(stack, [shifts.width for shifts in task.planes], task.border, plan.blurred)
    return room


def _source(field: NDArray, plan: _Plan, task: Task) -> Source:
    """One light field [V, U, C, H, W] as the memory that it spans."""
    working, starts = plan.scale.factors.dtype, plan.across.starts
    strides = np.array(field.strides, np.int64) // field.itemsize
    span = 1 + int((strides * (np.array(field.shape) - 1)).sum())
    memory = np.lib.stride_tricks.as_strided(field, (span,), (field.itemsize,))
    if not (field.dtype == working and strides[4] == 1 and _stays_on_views(plan.across, len(plan.columns), task)):
        return Source(memory, np.empty(0, working), starts, -1, strides, field.shape[1], plan.rows, plan.columns)
    u, place = np.divmod(starts, len(plan.columns))
    starts = place + u * strides[1]
    last = span - int(starts.max()) - rounded_up(task.size[1])
    return Source(memory, memory, starts, last, strides, field.shape[1], plan.rows, plan.columns)


def _stays_on_views(across: Horizontal, row_length: int, task: Task) -> bool:
    """Whether every tap reads samples that the views have, wherever it counts: a cubic's reach beyond the edges."""
    offsets, counts = across.starts % row_length - task.reach, across.begins < across.ends
    reads = (across.begins + offsets >= 0) & (across.ends + offsets <= task.size[1])
    return bool((reads | ~counts).all())


def _new_scratch(plan: _Plan, task: Task, working: np.dtype) -> Scratch:
    width = rounded_up(task.size[1])
    first = np.concatenate([[0], np.cumsum(plan.down.highest - plan.down.lowest + 1)])
    return Scratch(
        rows=np.zeros((len(task.aperture[0]), len(plan.columns)), working),
        total=np.empty(width, working),
        ring=np.zeros((first[-1], width), working),
        first=first,
    )


@functools.lru_cache(maxsize=16)
def _plan(task: Task, working: np.dtype, full_scale: int) -> _Plan:
    rows, columns = (task.beyond(axis).numpy() for axis in (0, 1))
    n_fill = rounded_up(task.size[1]) - task.size[1]
    factors = [_row_factors(task, shifts) for shifts in task.planes]
    return _Plan(
        rows,
        np.concatenate([columns, np.full(n_fill, -1)]),
        _horizontal(task, columns.size + n_fill, working),
        _vertical(task, working),
        _scale(task, factors, working, full_scale),
        [RowFactors(plane.factors.astype(working), plane.kinds) for plane in factors],
    )


def _horizontal(task: Task, row_length: int, working: np.dtype) -> Horizontal:
    """Tables of all planes; where all view rows stand at the same columns, one line of them serves all."""
    aperture = np.array(task.aperture)
    parts = [aperture] if task.is_separable else np.split(aperture, len(aperture))
    planes = [
        [list(_taps(task, *line, row_length)) for line in zip(shifts.columns, parts, strict=True)]
        for shifts in task.planes
    ]
    groups = np.array([max(-(-len(taps) // TAPS) for taps in plane) for plane in planes])
    shape = (len(planes), len(parts), groups.max(), TAPS)
    starts, begins, ends = (np.zeros(shape, np.int64) for _ in range(3))
    weights = np.zeros((len(planes), len(parts), len(parts[0]), *shape[2:]), working)
    for place in np.ndindex(shape[:2]):
        taps, part = planes[place[0]][place[1]], parts[place[1]]
        # What fills up the last group reads what is read anyway: 0 times a NaN from elsewhere would be NaN here.
        starts[place] = taps[0].start if taps else 0
        for k, tap in enumerate(taps):
            at = (*place, *divmod(k, TAPS))
            starts[at], begins[at], ends[at] = tap.start, *tap.span
            weights[(*place, slice(None), *at[2:])] = tap.weight * part[:, tap.u]
    spans = [[[tap.span for tap in taps] or [(0, task.size[1])] for taps in plane] for plane in planes]
    left = np.array([[max(begin for begin, _ in line) for line in plane] for plane in spans]).clip(max=task.size[1])
    right = np.array([[min(end for _, end in line) for line in plane] for plane in spans]).clip(left)
    # One of the two axes that count rows has length 1.
    return Horizontal(starts, weights.reshape(len(planes), -1, *shape[2:]), groups, begins, ends, left, right)


class _Tap(NamedTuple):
    """One sample of one view that a plane reads."""

    u: int
    start: int
    """Place in the U rows that it reads for x = 0."""
    weight: float
    span: tuple[int, int]
    """Columns that it serves."""


def _taps(task: Task, shifts: tuple[float, ...], aperture: NDArray, row_length: int) -> Iterator[_Tap]:
    """Of a line of views at these horizontal shifts, [U], which stands for rows of these weights, [..., U]."""
    is_open = aperture.sum(axis=0) > 0
    for u, shift in enumerate(shifts):
        for offset, weight in task.interpolation.taps(shift):
            if is_open[u] and weight != 0:
                start = u * row_length + task.reach + offset
                yield _Tap(u, start, weight, task.span(shift, 1))


def _vertical(task: Task, working: np.dtype) -> Vertical:
    taps = np.array([[task.interpolation.taps(shift) for shift in shifts.rows] for shifts in task.planes])
    is_open = np.array(task.aperture).sum(axis=1) > 0
    spans = np.array([[task.span(shift, 0) for shift in shifts.rows] for shifts in task.planes])
    offsets, weights = taps[..., 0].astype(np.int64), (taps[..., 1] * is_open[:, None]).astype(working)
    # Offsets of taps that are not taken must not lengthen the ring of unfinished rows.
    offsets = np.where(weights != 0, offsets, offsets[:, :1, :1])
    begins, ends = np.ascontiguousarray(spans[..., 0]), np.ascontiguousarray(spans[..., 1])
    lowest, highest = offsets.min((1, 2)), offsets.max((1, 2))
    return Vertical(offsets, weights, begins, ends, lowest, highest, int(lowest.min()), int(highest.max()))


def _scale(task: Task, rows: list[RowFactors], working: np.dtype, full_scale: int) -> Scale:
    """The factors of each plane's sum; one that is blurred is divided by its coverage after that."""
    flat = RowFactors(np.ones((1, task.size[1])), np.zeros(task.size[0], np.int64))
    planes = [flat if shifts.width > 0 else own for shifts, own in zip(task.planes, rows, strict=True)]
    factors = np.zeros((len(planes), max(len(plane.factors) for plane in planes), task.size[1]), working)
    for all_kinds, plane in zip(factors, planes, strict=True):
        all_kinds[: len(plane.factors)] = plane.factors / full_scale
    return Scale(factors, np.stack([plane.kinds for plane in planes]))


def _row_factors(task: Task, shifts: Shifts) -> RowFactors:
    """The factors of a plane; rows that the same views have a sample in, and around them, are of one kind."""
    has_sample = task.sampled(shifts)[0]
    around = boxes.boxed_along(has_sample, shifts.width, task.border, -1)
    same = np.concatenate([has_sample, around]) * task.border.counts_only_samples
    _, first, kinds = np.unique(same, axis=1, return_index=True, return_inverse=True)
    return RowFactors(task.factors(shifts)[first].numpy(), kinds)
