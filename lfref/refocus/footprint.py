"""Apertures with an area: each view stands for a cell, `fill_factor` view steps wide, instead of a point.

Within the cell light of disparity d moves by |s - d| pixels a view step, so that a plane is the sum of points blurred
by a box of w = fill_factor |s - d| pixels along x and along y: the same for all views, a filter of the finished plane.
As taps, a sample inside the box counts 1 / w; five taps at each end are fitted to the box's own response sinc(w k),
each frequency counting by the power 1 / k^2 of a natural picture. For all widths to 16 the response is met to 0.035
over k <= 0.4, to 0.009 over k <= 0.3. (A box over cubic interpolation, with as many taps, is off by 0.12 and 0.09.)

`box_planes` blurs finished planes on the CPU by compiled loops, `boxed` by PyTorch. Beyond its edge a plane continues
by the border rule. Where only samples count it is black there, and so is its coverage: the blurred sum over the
blurred coverage is the mean of what there is. Every sample under a box has a tap: a running sum would drift, and would
save little at the widths that slopes lead to.
Letters: `s` slope and `d` disparity in pixels per view step, `w` width in samples, `k` frequency in cycles per sample
(in loops, tap), `n` sample counted from the middle, `y x` row and column, `G` groups of `TAPS` taps.
Sources: Isaksen et al., "Dynamically reparameterized light fields", 2000; Stewart et al., "A new reconstruction filter
for undersampled light fields", 2003.
"""

import functools
import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.errors import InputError
from lfref.functional import loops, positive_definite
from lfref.functional.devices import on_device
from lfref.functional.loops import compiled, inlined
from lfref.refocus.sampling import BORDERS, TAPS, Border, Integers, Reals, add_taps, rounded_up, set_taps

ENDS = 5
"""Taps fitted at each end of a box; fewer miss the errors above, more would only cost."""
BAND = 0.4
"""Highest frequency at which the response has to be right, in cycles per sample."""


def taps(widths: Tensor, reach: int) -> Tensor:
    """Weights of the `2 reach + 1` samples around a pixel, of sum 1, for boxes of widths >= 0 in samples, [N, K].

    Widths [N] are float64, on any device, and no box reads more than `reach` samples to each side (`radius`).
    """
    n = torch.arange(reach + 1, dtype=torch.float64, device=widths.device)
    times = 2 - (n == 0).double()  # how often a weight stands in the symmetric filter
    width, radius = widths.clamp(min=1e-3)[:, None], ((widths / 2).ceil() + 1)[:, None]
    is_inner = n <= radius - ENDS
    # The places of the end taps; narrow boxes have fewer.
    ends = radius - ENDS + 1 + torch.arange(ENDS, dtype=torch.float64, device=widths.device)  # [N, ENDS]
    is_end = ends >= 0
    times_of_ends = (2 - (ends == 0).double()) * is_end
    # Least squares for the end taps under one condition, the sum 1, by its Lagrange multiplier.
    k = (torch.arange(200, dtype=torch.float64, device=widths.device) + 0.5) / 400  # more would change nothing
    free = times_of_ends[:, None] * torch.cos(2 * torch.pi * k[:, None] * ends[:, None])  # [N, k, ENDS]
    fixed = (times * is_inner / width) @ torch.cos(2 * torch.pi * n[:, None] * k)
    # Above the band little weight keeps the response from growing.
    weighted = free * (torch.where(k < BAND, 1.0, 0.01) / k.square())[:, None]
    goal = (weighted.mT @ (torch.sinc(width * k) - fixed)[..., None])[..., 0]
    system = weighted.mT @ free + torch.diag_embed(1.0 - is_end.double())
    fitted, excess = positive_definite.solved(system, torch.stack([goal, times_of_ends], -1)).unbind(-1)
    rest = 1 - (times * is_inner / width).sum(1)
    multiplier = ((times_of_ends * fitted).sum(1) - rest) / (times_of_ends * excess).sum(1)
    fitted = (fitted - multiplier[:, None] * excess) * is_end
    half = is_inner / width + (fitted[:, None] @ (ends[..., None] == n).double())[:, 0]
    half = torch.where(widths[:, None] > 0, half, (n == 0).double())
    return torch.cat([half[:, 1:].flip(1), half], 1)


def radius(width: float) -> int:
    """Samples to each side that a box reads."""
    return math.ceil(width / 2) + 1 if width > 0 else 0


class Footprint(NamedTuple):
    """The pixels that a view's cell covers."""

    fill_factor: float
    """Side of a cell in view steps, >= 0; 0: views are points, and planes the plain sums."""
    disparity: float
    """Of the scene, in pixels per view step."""
    size: tuple[int, int]
    """Height and width of a view in pixels."""

    def widths(self, slopes: Tensor) -> Tensor:
        """Signed widths of the boxes in pixels for slopes [N]."""
        widths = self.fill_factor * (slopes - self.disparity)
        if not (widest := float(widths.detach().abs().max())) <= max(self.size):
            raise InputError(
                f"fill_factor * |slope - disparity| must be at most the picture's {max(self.size)} px",
                got=f"{widest:g} px",
                remedy="disparity is finite, and in pixels per view step, as slopes are",
            )
        return widths

    def responses(self, slopes: Tensor, frequencies: Tensor) -> Tensor:
        """Real factors of the frequencies along one axis, [N, 1, K]."""
        return torch.sinc(on_device(self.widths(slopes), frequencies.device)[:, None, None] * frequencies)


def checked(fill_factor: float, disparity: float, views: Tensor) -> Footprint:
    """The footprint of the cells of views [..., V, U, C, H, W]."""
    if not 0 <= fill_factor < math.inf:
        raise InputError(
            "fill_factor must be finite and >= 0, in view steps", got=fill_factor, remedy="1 fills the aperture"
        )
    return Footprint(float(fill_factor), float(disparity), (views.shape[-2], views.shape[-1]))


LEAST_SHARE = 0.125
"""Least share of its own coverage that a pixel needs in the blurred coverage: the fitted taps of a box are negative in
places, and a quotient by next to nothing would be a dot."""


def boxed(planes: Tensor, taps: Tensor, border: Border) -> Tensor:
    """Planes [..., N, C, H, W] blurred along both axes, each by its own taps [N, K]."""
    down, across = (_bands(taps.to(planes), border, length)[:, None] for length in planes.shape[-2:])
    return down @ (planes @ across.mT)


def boxed_lines(lines: Tensor, taps: Tensor, border: Border) -> Tensor:
    """Lines [N, ..., L] blurred along themselves, each by the taps [N, K] of its plane."""
    bands = _bands(taps.to(lines), border, lines.shape[-1])
    return lines @ bands.reshape(taps.shape[0], *[1] * (lines.ndim - 3), *bands.shape[1:]).mT


def _bands(taps: Tensor, border: Border, length: int) -> Tensor:
    """Matrices [N, L, L] that blur an axis of some length by taps [N, K]."""
    rule = BORDERS["zero"] if border.counts_only_samples else border
    pixel, tap = (torch.arange(n, device=taps.device) for n in (length, taps.shape[1]))
    index, exists = rule.tap(pixel[:, None] + tap - taps.shape[1] // 2, torch.ones_like(taps[:1]), length)
    weights = (taps[:, None] * exists).expand(-1, length, -1)
    return taps.new_zeros(taps.shape[0], length, length).scatter_add(2, index.expand_as(weights), weights)


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
    """Blur planes [B, N, C, H, W] in place, each by its box [N], then multiply them by factors; width 0: neither."""
    boxes = [_box(width, border, stack.shape[-2:], stack.dtype) for width in widths]

    def work(b: int, n: int, c: int) -> None:
        image = stack[b, n, c]
        _blur(image, boxes[n], *scales[n], _workspace(image, boxes[n]))

    wide = [n for n, width in enumerate(widths) if width > 0]
    jobs = itertools.product(range(stack.shape[0]), wide, range(stack.shape[2]))
    loops.share(work, jobs, loops.worthwhile(stack.size, 1 << 16))  # samples from which one more thread pays


@functools.lru_cache(maxsize=256)
def _box(width: float, border: Border, size: tuple[int, int], working: np.dtype) -> Box:
    reach, rule = radius(width), BORDERS["zero"] if border.counts_only_samples else border
    weights = taps(torch.tensor([width], dtype=torch.float64), reach)[0].numpy()
    filled = np.zeros((-(-len(weights) // TAPS), TAPS), working)
    filled.flat[: len(weights)] = weights
    rows, columns = (rule.indices(reach, length).numpy() for length in size)
    return Box(reach, filled, rows[:reach], rows[reach + size[0] :], columns)


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
