"""Finished planes blurred by the boxes of `footprint`: on the CPU by compiled loops, elsewhere by PyTorch.

Beyond its edge a plane continues by the border rule. Where only samples count it is black there, and so is its
coverage: the blurred sum over the blurred coverage is the mean of what there is. Every sample under a box has a tap: a
running sum would drift, and would save little at the widths that slopes lead to.
Letters: `y x` row and column, `k` tap, `G` groups of `TAPS` taps, `d` disparity, `s` slope.
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
from lfref.functional.row_sums import TAPS, Integers, Reals, add_taps, rounded_up, set_taps
from lfref.refocus import batches, footprint
from lfref.refocus.footprint import Footprint
from lfref.refocus.sampling import BORDERS, Border

LEAST_SHARE = 0.125
"""Least share of its own coverage that a pixel needs in the blurred coverage: the fitted taps of a box are negative in
places, and a quotient by next to nothing would be a dot."""


def blurred(stack: Tensor, widths: Tensor, border: Border, coverage: Tensor | None = None) -> Tensor:
    """Planes blurred by a box of another width at every pixel, [B, N, C, H, W], 0 where there is no coverage.

    Args:
        stack: Planes as sums over points, float32 or float64, [B, N, C, H, W].
        widths: Of the boxes, with any sign, in pixels, where the stack is, [B or 1, N, H, W].
        border: How planes continue beyond their edges.
        coverage: Share of the aperture that has a sample, [N, H, W]; read where only samples count.
    """
    places = footprint.place(widths.to(stack.dtype).square())
    covered = coverage.to(stack) if border.counts_only_samples and coverage is not None else None
    if batches.compiler_for(stack, places) == "numba":
        return blurred_numba(stack, places, border, covered)
    planes = []
    for n, own in enumerate(places.unbind(1)):
        if covered is None:
            planes.append(blended(stack[:, n], own, border))
        else:
            weight = blended(covered[n].expand(len(own), 1, -1, -1), own, border)
            planes.append(blended(stack[:, n] * covered[n], own, border) * inverse(covered[n], weight))
    return torch.stack(planes, dim=1)


def periodic(stack: Tensor, cell: Footprint, slopes: Tensor) -> Tensor:
    """Planes [B, N, C, H, W] that wrap around, blurred if the blur varies; a constant one is part of the spectrum."""
    if cell.fill == 0 or not cell.varies(slopes):
        return stack
    return blurred(stack, cell.widths(slopes), BORDERS["wrap"])


def boxed(images: Tensor, width: float, border: Border, axes: Sequence[int] = (-1, -2)) -> Tensor:
    """Images [..., H, W] blurred by a box of `width` >= 0 pixels along axes, by plain PyTorch operations."""
    weights = footprint.taps(width)
    if len(weights) == 1:
        return images
    rule = BORDERS["zero"] if border.counts_only_samples else border
    for axis in axes:
        length = images.shape[axis]
        # By index, not `Border.extend`: a box may be wider than the image.
        index = rule.indices(len(weights) // 2, length).to(images.device)
        extended = images.index_select(axis, index.clamp(min=0))
        if bool((index < 0).any()):
            extended = extended.masked_fill((index < 0)[(...,) + (None,) * (-1 - axis)], 0)
        images = extended.narrow(axis, 0, length) * weights[0]
        for k, weight in enumerate(weights[1:], start=1):
            images = images.add(extended.narrow(axis, k, length), alpha=weight)
    return images


def blended(planes: Tensor, places: Tensor, border: Border) -> Tensor:
    """Images [B, C, H, W] blurred by boxes of these places [B or 1, H, W] among the levels, by PyTorch operations."""
    total = torch.zeros_like(planes)
    for level in footprint.spanned(places):
        share = (1 - (places - level).abs()).clamp(min=0)[:, None]
        total = total + share.to(planes) * boxed(planes, footprint.width(level), border)
    return total


def inverse(coverage: Tensor, blurred: Tensor) -> Tensor:
    """One over the blurred coverage; 0 where a pixel is not covered, or nearly nothing around it is."""
    counts = (coverage > 0) & (blurred > LEAST_SHARE * coverage)
    return torch.where(counts, 1 / torch.where(counts, blurred, 1.0), 0.0)


class RowFactors(NamedTuple):
    """What the rows of a plane are multiplied by; rows of one kind share their factors."""

    factors: NDArray
    """[kinds, W]."""
    kinds: NDArray
    """[H]."""


class Box(NamedTuple):
    """Taps of one width, and the indices of the samples that they read beyond the edges of a plane; -1 reads black."""

    radius: int
    """Samples to each side that are read."""
    weights: Reals
    """Along a row as down a column; the last group filled up by 0, [G, TAPS]."""
    above: Integers
    """Index of the row at each position above the plane, [radius]."""
    below: Integers
    """Index of the row at each position below the plane, [radius]."""
    columns: Integers
    """Index of the column at each position from -radius to W + radius, [W + 2 radius]."""


class Workspace(NamedTuple):
    """Memory of one thread."""

    head: Reals
    """Copies of the rows above the plane, [radius, W]; copies, for the plane is overwritten."""
    tail: Reals
    """Copies of the rows below the plane, [radius, W]."""
    line: Reals
    """A row, continued beyond both ends."""
    ring: Reals
    """The last 2 radius + 1 rows, blurred along themselves, one after the other."""
    total: Reals
    """A blurred row, [W rounded up]."""
    starts: Integers
    """First sample of each tap, [G, TAPS]."""


def box_planes(stack: NDArray, widths: Sequence[float], border: Border, scales: Sequence[RowFactors]) -> None:
    """Blur planes in place on the CPU, each by its own box, then multiply them by their factors; width 0: neither.

    Args:
        stack: Float32 or float64, [B, N, C, H, W].
        widths: Of the boxes in pixels, >= 0, [N].
        border: How planes continue; black where only samples count.
        scales: What each is multiplied by when it is blurred, [N].
    """
    boxes = [_box(width, border, stack.shape[-2:], stack.dtype) for width in widths]

    def work(b: int, n: int, c: int) -> None:
        image = stack[b, n, c]
        _blur(image, boxes[n], *scales[n], _workspace(image, boxes[n]))

    wide = [n for n, width in enumerate(widths) if width > 0]
    jobs = itertools.product(range(stack.shape[0]), wide, range(stack.shape[2]))
    threads.share(work, jobs, threads.worthwhile(stack.size, 1 << 16))  # samples from which one more thread pays


def blurred_numba(stack: Tensor, places: Tensor, border: Border, covered: Tensor | None) -> Tensor:
    """As `blurred` on the CPU, by compiled loops; `places` are the widths as places among the levels."""
    planes, shares = stack.detach().contiguous().numpy(), places.detach().to(stack).contiguous().numpy()
    levels = [footprint.spanned(plane) for plane in places.unbind(1)]
    boxes = {
        level: _box(footprint.width(level), border, planes.shape[-2:], planes.dtype)
        for level in set(itertools.chain(*levels))
    }
    n_threads = threads.worthwhile(planes.size, 1 << 16)
    coverage = np.ones((len(levels), 1, 1), planes.dtype) if covered is None else covered.numpy()
    factors, total = np.ones(shares.shape, planes.dtype), np.empty(planes.shape, planes.dtype)
    real = planes.dtype.type  # whole numbers would make the loop compute in float64

    def blend(image: NDArray, b: int, n: int) -> NDArray:
        result = np.zeros_like(image)
        for level in levels[n]:
            box = boxes[level]
            _add_level(image, box, shares[b, n], real(level), real(1), result, _workspace(image, box))
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


@functools.lru_cache(maxsize=256)
def _box(width: float, border: Border, size: tuple[int, int], working: np.dtype) -> Box:
    weights = footprint.taps(width)
    radius, rule = len(weights) // 2, BORDERS["zero"] if border.counts_only_samples else border
    filled = np.zeros((-(-len(weights) // TAPS), TAPS), working)
    filled.flat[: len(weights)] = weights
    rows, columns = (rule.indices(radius, length).numpy() for length in size)
    return Box(radius, filled, rows[:radius], rows[radius + size[0] :], columns)


def _workspace(image: NDArray, box: Box) -> Workspace:
    length, zero = rounded_up(image.shape[1]), image.dtype.type(0)
    head, tail = (np.where(rows[:, None] >= 0, image[rows], zero) for rows in (box.above, box.below))
    return Workspace(
        head,
        tail,
        line=np.zeros(length + 2 * box.radius, image.dtype),  # finite beyond the ends of its row: 0 * NaN is NaN
        ring=np.empty((2 * box.radius + 1) * length, image.dtype),
        total=np.empty(length, image.dtype),
        starts=np.empty(box.weights.shape, np.int64),
    )


@compiled
def _blur(image: Reals, box: Box, factors: Reals, kinds: Integers, work: Workspace) -> None:
    """Blur a plane [H, W] in place, and multiply its rows by `factors[kinds]`."""
    for y in range(-box.radius, image.shape[0] + box.radius):
        _blur_along(y, image, box, work)
        r = y - box.radius  # the row whose last neighbour is in the ring now: it is overwritten, and not read again
        if r >= 0:
            _blur_down(r, box, work)
            result, row_factors = image[r], factors[kinds[r]]
            for x in range(result.size):
                result[x] = work.total[x] * row_factors[x]


@compiled
def _add_level(image: Reals, box: Box, places: Reals, level: float, unit: float, total: Reals, work: Workspace) -> None:
    """Blur a plane by the box of a level, and add its share to the pixels whose place is less than 1 from it."""
    for y in range(-box.radius, image.shape[0] + box.radius):
        _blur_along(y, image, box, work)
        r = y - box.radius
        if r >= 0:
            result, row = total[r], places[r]
            n_blended = 0  # most rows blend few of the levels: those without any pixel are left out
            for x in range(row.size):
                n_blended += abs(row[x] - level) < unit
            if n_blended > 0:
                _blur_down(r, box, work)
                for x in range(result.size):
                    result[x] += max(unit - abs(row[x] - level), unit - unit) * work.total[x]


@inlined
def _blur_along(y: int, image: Reals, box: Box, work: Workspace) -> None:
    """Blur row y along x; the result goes into the ring of `work`."""
    (height, width), n_rows, length = image.shape, 2 * box.radius + 1, work.total.size
    row = work.head[y + box.radius] if y < 0 else (image[y] if y < height else work.tail[y - height])
    inner = work.line[box.radius : box.radius + width]
    for x in range(width):
        inner[x] = row[x]
    for x in range(box.radius):
        left, right = box.columns[x], box.columns[box.radius + width + x]
        work.line[x] = row[left] if left >= 0 else 0
        work.line[box.radius + width + x] = row[right] if right >= 0 else 0
    # Taps of weight 0 that fill up the last group read the first sample.
    for k in range(work.starts.size):
        work.starts[k // TAPS, k % TAPS] = k if k < n_rows else 0
    place = (y + box.radius) % n_rows
    _sum(work.line, work.starts, box.weights, work.ring[place * length : (place + 1) * length])


@inlined
def _blur_down(r: int, box: Box, work: Workspace) -> None:
    """Blur row r along y, from the rows around it, which are all in the ring of `work`."""
    n_rows, length = 2 * box.radius + 1, work.total.size
    for k in range(work.starts.size):
        work.starts[k // TAPS, k % TAPS] = ((r + (k if k < n_rows else 0)) % n_rows) * length
    _sum(work.ring, work.starts, box.weights, work.total)


@inlined
def _sum(rows: Reals, starts: Integers, weights: Reals, total: Reals) -> None:
    set_taps(rows, starts[0], weights[0], total)
    for g in range(1, weights.shape[0]):
        add_taps(rows, starts[g], weights[g], total)
