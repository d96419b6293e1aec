"""Planes blurred by boxes on the CPU, at the machine's speed: tables for the compiled loops, and threads.

A tap for every sample, not a running sum: it drifts nowhere, and costs less than the sum over the views up to boxes as
wide as any slope that is allowed makes them.
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
from lfref.functional.row_sums import TAPS, rounded_up
from lfref.refocus.borders import BORDERS, Border
from lfref.refocus.footprint import box, box_loop, by_torch, levels
from lfref.refocus.footprint.box_loop import Around, Box, Scratch

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


def blurred(stack: Tensor, places: Tensor, border: Border, covered: Tensor | None) -> Tensor:
    """Stacks on the CPU; as `by_torch.blurred`."""
    planes, shares = stack.detach().contiguous().numpy(), places.detach().to(stack).contiguous().numpy()
    used = [levels.spanned(plane) for plane in places.unbind(1)]
    every = {level for plane in used for level in plane}
    filters = {level: _filter(levels.width(level), border, planes.shape[-2:], planes.dtype) for level in every}
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
        factors[b, n] = by_torch.inverse(torch.from_numpy(coverage[n]), weight).numpy()

    def work(b: int, n: int, c: int) -> None:
        own = b % len(shares)
        np.multiply(blend(planes[b, n, c] * coverage[n], own, n), factors[own, n], out=total[b, n, c])

    if covered is not None:
        threads.share(weigh, itertools.product(*map(range, shares.shape[:2])), n_threads)
    threads.share(work, itertools.product(*map(range, planes.shape[:3])), n_threads)
    return torch.from_numpy(total)


def _blur(image: NDArray, way: _Filter, scale: RowFactors) -> None:
    box_loop.blur(image, _around(image, way), way.box, *scale, _new_scratch(image, way.box))


def _add_level(image: NDArray, way: _Filter, places: NDArray, level: int, total: NDArray) -> None:
    at, unit = image.dtype.type(level), image.dtype.type(1)
    box_loop.add_level(image, _around(image, way), way.box, places, at, unit, total, _new_scratch(image, way.box))


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
    weights = box.taps(width)
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
