"""Finished planes blurred by boxes that differ from pixel to pixel: the last step of every operator that has a map.

Letters: `d` disparity, `s` slope; the footprint's.
"""

import functools
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.functional import threads
from lfref.functional.jit import compiled, inlined
from lfref.functional.row_sums import TAPS, add_taps, rounded_up, set_taps
from lfref.refocus import batches, footprint
from lfref.refocus.footprint import Footprint
from lfref.refocus.sampling import BORDERS, Border

# PART box_loop
# The compiled loops that blur a plane by a box: along each row as it is read, then down a ring of such rows.
#
# Letters: `y x` row and column, `k` tap, `g` group of `TAPS` taps.

Integers = NDArray[np.int64]
Reals = NDArray[np.floating]


class Box(NamedTuple):
    """Taps of one width."""

    radius: int
    """Samples to each side that are read."""
    weights: Reals
    """Along a row as down a column; the last group filled up by 0, [G, TAPS]."""


class Scratch(NamedTuple):
    """What one thread works in."""

    line: Reals
    """A row, continued beyond both ends."""
    ring: Reals
    """Rows blurred along themselves, used in turn, one after the other."""
    total: Reals
    """A blurred row, [W rounded up]."""
    starts: Integers
    """Where taps read, [G, TAPS]."""


class Around(NamedTuple):
    """What stands beyond the edges of a plane."""

    head: Reals
    """Rows above it, `radius` of them, [radius, W]."""
    tail: Reals
    """Rows below it, likewise."""
    columns: Integers
    """Column of each place from -radius to W + radius; -1: black, [W + 2 radius]."""


@compiled
def blur(image: Reals, around: Around, box: Box, factors: Reals, kinds: Integers, work: Scratch) -> None:
    """Blur a plane where it lies.

    Args:
        image: [H, W].
        around: What it is continued by.
        box: The taps.
        factors: What a blurred row is multiplied by, [kinds, W].
        kinds: Which of them, for each row, [H].
        work: To work in; what lies beyond its rows' ends is finite.
    """
    for y in range(-box.radius, image.shape[0] + box.radius):
        _blur_along(y, image, around, box, work)
        r = y - box.radius
        if r >= 0:
            _blur_down(r, box, work)
            result, row_factors = image[r], factors[kinds[r]]
            for x in range(result.size):
                result[x] = work.total[x] * row_factors[x]


@compiled
def add_level(
    image: Reals, around: Around, box: Box, places: Reals, level: float, unit: float, total: Reals, work: Scratch
) -> None:
    """Blur a plane by the box of a level, and add its share to the pixels that blend it.

    Args:
        image: [H, W].
        around: What it is continued by.
        box: The taps.
        places: Of the pixels' widths among the levels, [H, W].
        level: In the type of the image, as `unit`: whole numbers would make the loop compute in float64.
        unit: 1.
        total: Added to, [H, W].
        work: As of `blur`.
    """
    for y in range(-box.radius, image.shape[0] + box.radius):
        _blur_along(y, image, around, box, work)
        r = y - box.radius
        if r >= 0:
            result, row = total[r], places[r]
            if _is_blended(row, level, unit):
                _blur_down(r, box, work)
                for x in range(result.size):
                    result[x] += max(unit - abs(row[x] - level), unit - unit) * work.total[x]


@inlined
def _is_blended(places: Reals, level: float, unit: float) -> bool:
    """Whether any pixel of a row has a share of a level."""
    count = 0
    for x in range(places.size):
        count += abs(places[x] - level) < unit
    return count > 0


@inlined
def _blur_along(y: int, image: Reals, around: Around, box: Box, work: Scratch) -> None:
    """Blur a row along itself, into the ring."""
    height, n_rows, length = image.shape[0], 2 * box.radius + 1, work.total.size
    row = around.head[y + box.radius] if y < 0 else (image[y] if y < height else around.tail[y - height])
    _extend(row, around.columns, box.radius, work.line)
    for k in range(work.starts.size):
        work.starts[k // TAPS, k % TAPS] = k if k < n_rows else 0
    place = (y + box.radius) % n_rows
    _sum(work.line, work.starts, box.weights, work.ring[place * length : (place + 1) * length])


@inlined
def _blur_down(r: int, box: Box, work: Scratch) -> None:
    """Blur the rows around row r, all of them in the ring, down the columns."""
    n_rows, length = 2 * box.radius + 1, work.total.size
    for k in range(work.starts.size):
        work.starts[k // TAPS, k % TAPS] = ((r + (k if k < n_rows else 0)) % n_rows) * length
    _sum(work.ring, work.starts, box.weights, work.total)


@inlined
def _extend(row: Reals, columns: Integers, radius: int, line: Reals) -> None:
    width = row.size
    inner = line[radius : radius + width]
    for x in range(width):
        inner[x] = row[x]
    for x in range(radius):
        left, right = columns[x], columns[radius + width + x]
        line[x] = row[left] if left >= 0 else 0
        line[radius + width + x] = row[right] if right >= 0 else 0


@inlined
def _sum(rows: Reals, starts: Integers, weights: Reals, total: Reals) -> None:
    set_taps(rows, starts[0], weights[0], total)
    for g in range(1, weights.shape[0]):
        add_taps(rows, starts[g], weights[g], total)


# PART by_torch
# Planes blurred by boxes, by plain PyTorch operations: on any device, and differentiable.
#
# Beyond its edge a plane is what the border rule makes of it. Where only samples count it is black there, and so is its
# coverage: the blurred sum over the blurred coverage is the mean of what there is.

LEAST_SHARE = 0.125
"""Share of its own coverage that a pixel must find around it: the taps of a box sum up to nothing in odd places."""


def boxed(images: Tensor, width: float, border: Border) -> Tensor:
    """Images blurred by a box along both axes.

    Args:
        images: Floating point, [..., H, W].
        width: Of the box in pixels, >= 0.
        border: How they continue; black where only samples count.
    """
    return boxed_along(boxed_along(images, width, border, -1), width, border, -2)


def boxed_along(images: Tensor, width: float, border: Border, axis: int) -> Tensor:
    """The same along one axis, -1 (columns) or -2 (rows)."""
    weights, length = footprint.taps(width), images.shape[axis]
    if len(weights) == 1:
        return images
    extended = _extended(images, len(weights) // 2, axis, border)
    total = extended.narrow(axis, 0, length) * weights[0]
    for k, weight in enumerate(weights[1:], start=1):
        total = total.add(extended.narrow(axis, k, length), alpha=weight)
    return total


def blurred_torch(stack: Tensor, places: Tensor, border: Border, covered: Tensor | None) -> Tensor:
    """Planes blurred by a box of another width at every pixel, over the weight of the samples that count.

    Args:
        stack: [B, N, C, H, W].
        places: Of the widths among the `levels`, [B or 1, N, H, W].
        border: As of `boxed`.
        covered: Share of the aperture that has a sample, in the type of the stack, [N, H, W]; None: all of it.
    """
    planes = []
    for n, own in enumerate(places.unbind(1)):
        if covered is None:
            planes.append(blended(stack[:, n], own, border))
        else:
            weight = blended(covered[n].expand(len(own), 1, -1, -1), own, border)
            planes.append(blended(stack[:, n] * covered[n], own, border) * inverse(covered[n], weight))
    return torch.stack(planes, dim=1)


def blended(planes: Tensor, places: Tensor, border: Border) -> Tensor:
    """Images blurred by a box of another width at every pixel.

    Args:
        planes: Floating point, [B, C, H, W].
        places: Of the widths among the `levels`, [B or 1, H, W].
        border: As of `boxed`.
    """
    total = torch.zeros_like(planes)
    for level in footprint.spanned(places):
        share = (1 - (places - level).abs()).clamp(min=0)[:, None]
        total = total + share.to(planes) * boxed(planes, footprint.width(level), border)
    return total


def inverse(coverage: Tensor, blurred: Tensor) -> Tensor:
    """One over the blurred coverage; 0 where a pixel is not covered, or nearly nothing around it is.

    Args:
        coverage: Share of the aperture that has a sample at each pixel, >= 0, any shape.
        blurred: The same, blurred as the plane is.
    """
    counts = (coverage > 0) & (blurred > LEAST_SHARE * coverage)
    return torch.where(counts, 1 / torch.where(counts, blurred, 1.0), 0.0)


def _extended(images: Tensor, pad: int, axis: int, border: Border) -> Tensor:
    """The images with `pad` more samples at both ends of an axis, which may be more than they have."""
    length = images.shape[axis]
    if border.counts_only_samples:
        border = BORDERS["zero"]
    places = torch.arange(-pad, length + pad, device=images.device)
    index, weight = border.tap(places, torch.ones_like(places), length)
    extended = images.index_select(axis, index)
    if bool(weight.all()):
        return extended
    return extended.masked_fill((weight == 0)[(...,) + (None,) * (-1 - axis)], 0)


# PART by_numba
# Planes blurred by boxes on the CPU, at the machine's speed: tables for the compiled loops, and threads.
#
# A tap for every sample, not a running sum: it drifts nowhere, and costs less than the sum over the views up to boxes
# as
# wide as any slope that is allowed makes them.

WORTH_A_THREAD = 1 << 16
"""Samples of a stack from which one more thread saves more than it costs."""


class RowFactors(NamedTuple):
    """What the rows of a plane are multiplied by; rows of one kind share their factors."""

    factors: NDArray
    """[kinds, W]."""
    kinds: NDArray
    """[H]."""


class _Filter(NamedTuple):
    """A box, and what it reads beyond the edges of a plane."""

    box: Box
    above: NDArray
    """Row that stands at each place above the plane; -1: black, [radius]."""
    below: NDArray
    """Likewise below it, [radius]."""
    columns: NDArray
    """As of `box_loop.Around`."""


def box_planes(stack: NDArray, widths: Sequence[float], border: Border, scales: Sequence[RowFactors]) -> None:
    """Blur planes where they lie, each by a box of its own; those of width 0 stay as they are.

    Args:
        stack: Float32 or float64, [B, N, C, H, W].
        widths: Of the boxes in pixels, >= 0, [N].
        border: How planes continue; black where only samples count.
        scales: What each is multiplied by when it is blurred, [N].
    """
    filters = [_filter(width, border, stack.shape[-2:], stack.dtype) for width in widths]

    def work(b: int, n: int, c: int) -> None:
        _blur(stack[b, n, c], filters[n], scales[n])

    wide = [n for n, width in enumerate(widths) if width > 0]
    jobs = itertools.product(range(stack.shape[0]), wide, range(stack.shape[2]))
    threads.share(work, jobs, threads.worthwhile(stack.size, WORTH_A_THREAD))


def blurred_numba(stack: Tensor, places: Tensor, border: Border, covered: Tensor | None) -> Tensor:
    """Stacks on the CPU; as `by_torch.blurred`."""
    planes, shares = stack.detach().contiguous().numpy(), places.detach().to(stack).contiguous().numpy()
    used = [footprint.spanned(plane) for plane in places.unbind(1)]
    every = {level for plane in used for level in plane}
    filters = {level: _filter(footprint.width(level), border, planes.shape[-2:], planes.dtype) for level in every}
    n_threads = threads.worthwhile(planes.size, WORTH_A_THREAD)
    coverage = np.ones((len(used), 1, 1), planes.dtype) if covered is None else covered.numpy()
    factors, total = np.ones(shares.shape, planes.dtype), np.empty(planes.shape, planes.dtype)

    def blend(image: NDArray, b: int, n: int) -> NDArray:
        result = np.zeros_like(image)
        for level in used[n]:
            _add_level(image, filters[level], shares[b, n], level, result)
        return result

    def weigh(b: int, n: int) -> None:
        weight = torch.from_numpy(blend(coverage[n], b, n))
        factors[b, n] = inverse(torch.from_numpy(coverage[n]), weight).numpy()

    def work(b: int, n: int, c: int) -> None:
        own = b % len(shares)
        np.multiply(blend(planes[b, n, c] * coverage[n], own, n), factors[own, n], out=total[b, n, c])

    if covered is not None:
        threads.share(weigh, itertools.product(*map(range, shares.shape[:2])), n_threads)
    threads.share(work, itertools.product(*map(range, planes.shape[:3])), n_threads)
    return torch.from_numpy(total)


def _blur(image: NDArray, way: _Filter, scale: RowFactors) -> None:
    blur(image, _around(image, way), way.box, *scale, _new_scratch(image, way.box))


def _add_level(image: NDArray, way: _Filter, places: NDArray, level: int, total: NDArray) -> None:
    at, unit = image.dtype.type(level), image.dtype.type(1)
    add_level(image, _around(image, way), way.box, places, at, unit, total, _new_scratch(image, way.box))


def _around(image: NDArray, way: _Filter) -> Around:
    black = image.dtype.type(0)
    head, tail = (np.where(rows[:, None] >= 0, image[rows], black) for rows in (way.above, way.below))
    return Around(head, tail, way.columns)


def _new_scratch(image: NDArray, box: Box) -> Scratch:
    length = rounded_up(image.shape[1])
    return Scratch(
        line=np.zeros(length + 2 * box.radius, image.dtype),
        ring=np.empty((2 * box.radius + 1) * length, image.dtype),
        total=np.empty(length, image.dtype),
        starts=np.empty(box.weights.shape, np.int64),
    )


@functools.lru_cache(maxsize=256)
def _filter(width: float, border: Border, size: tuple[int, int], working: np.dtype) -> _Filter:
    weights = footprint.taps(width)
    radius = len(weights) // 2
    filled = np.zeros((-(-len(weights) // TAPS), TAPS), working)
    filled.flat[: len(weights)] = weights
    rows, columns = (_beyond(radius, length, border) for length in size)
    return _Filter(Box(radius, filled), rows[:radius], rows[radius + size[0] :], columns)


def _beyond(radius: int, length: int, border: Border) -> NDArray:
    """Sample that stands at each place from -radius to length + radius; -1: black."""
    rule = BORDERS["zero"] if border.counts_only_samples else border
    places = torch.arange(-radius, length + radius)
    index, weight = rule.tap(places, torch.ones_like(places), length)
    return torch.where(weight > 0, index, -1).numpy()


def blurred(stack: Tensor, widths: Tensor, border: Border, coverage: Tensor | None = None) -> Tensor:
    """Planes seen through the cells of the aperture.

    Args:
        stack: Planes as sums over points, float32 or float64, [B, N, C, H, W].
        widths: Of the boxes, with any sign, in pixels, where the stack is, [B or 1, N, H, W].
        border: How planes continue beyond their edges.
        coverage: Share of the aperture that has a sample, [N, H, W]; read where only samples count.

    Returns:
        [B, N, C, H, W], 0 where there is no coverage.
    """
    places = footprint.place(widths.to(stack.dtype).square())
    covered = coverage.to(stack) if border.counts_only_samples and coverage is not None else None
    if batches.compiler_for(stack, places) == "numba":
        # Imported here: a compiler takes half a second to load, which a program that never refocuses need not spend.
        pass

        return blurred_numba(stack, places, border, covered)
    return blurred_torch(stack, places, border, covered)


def periodic(stack: Tensor, cell: Footprint, slopes: Tensor) -> Tensor:
    """Planes that wrap around seen through cells whose blur varies; others have been through their response.

    Args:
        stack: [B, N, C, H, W].
        cell: What each view covers of the picture.
        slopes: Of the planes, float64, [N].
    """
    if cell.fill == 0 or not cell.varies(slopes):
        return stack
    return blurred(stack, cell.widths(slopes), BORDERS["wrap"])
