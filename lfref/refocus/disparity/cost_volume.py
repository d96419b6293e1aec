"""The cost volume of matching: at each slope and pixel, the share of views that disagree with the others.

A plane sweep: views are shifted by each slope in turn, `L[v, u](x + s u, y + s v)`, and compared where they show the
same point if s is its disparity. Every view has one vote, a soft one: its difference e from the reference costs
`e^2 / (e^2 + sigma^2)` (Geman-McClure), so that a difference far beyond noise is one whole disagreement however great
it is. So the views from which a nearer surface hides the point outvote nobody, wherever in the aperture they are, and a
bright edge weighs no more than weak texture. The reference is first the mean of the central views, then the mean of all
weighted by `sigma^2 / (e^2 + sigma^2)`: less noise, and no view is special.
What is compared is the views' detail (`details`): shading that moves otherwise than the surface, as gloss does, would
outvote the fine texture under it, which moves with it.
`sigma^2` (the spread, one number a pixel) is the sum of noise, which is measured, and of the errors of interpolation
and of the slopes' distance, which grow with the gradient.
Letters: `s` slope in pixels per view step, `N` slopes, `K` views that are read, `k` view, `v u` its row and column from
the angular centre, `y x` pixel row and column, `p q` position in a view along y and x, `t` fraction of a sample.
Sources: Black, Rangarajan, "On the Unification of Line Processes, Outlier Rejection, and Robust Statistics", 1996; He,
Sun, Tang, "Guided Image Filtering", 2013 (`details`).
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.errors import InputError
from lfref.functional import loops, neighbours
from lfref.functional.devices import is_known, number, on_device, on_host
from lfref.functional.loops import compiled, inlined
from lfref.refocus import batches
from lfref.refocus.sampling import BORDERS, CUBIC, is_sampled
from lfref.refocus.shift.shift_bands import moved_by_bands

Reals = NDArray[np.float32]
Integers = NDArray[np.int64]
Number = float | np.floating
Taps = tuple[Number, Number, Number, Number]

LEAST_NOISE = 6e-4
"""Standard deviation that even good views have: the mean of three colours that are rounded to 8 bits has
1 / 255 / sqrt(36) = 6.5e-4."""
SHADING = 0.88
"""Share of what a guided filter keeps, shading and strong edges, that is taken away where there is no noise."""
CONTRAST = 0.02
"""Contrast in windows of 3 by 3, as a share of the mean light, from which the filter keeps an edge."""
NOISY = 2.0
"""Variances of the noise that count as half a disagreement: the variance of a difference of two views."""
STEEP = 0.05
"""Pixels that a view a step from the centre is off about halfway between slopes that are tried."""
QUIET = 0.25
"""Share of pixels that show nothing but noise at their best slope: others are interpolated, hidden, or shine."""


class GreyViews(NamedTuple):
    """Grey views of one light field, without those of weight 0."""

    samples: Tensor
    """Float32, [K, H, W]."""
    positions: Tensor
    """v and u of each, in view steps from the angular centre, float64, CPU, [K, 2]."""
    middle: list[int]
    """Indices of the views nearest to the angular centre: one, or those around it."""

    @property
    def central(self) -> Tensor:
        """The picture in the middle, [H, W]."""
        return torch.stack([self.samples[k] for k in self.middle]).mean(0)


def grey_of(views: Tensor, aperture: Tensor) -> Tensor:
    """Grey views [V, U, H, W] on the CPU of checked ones [V, U, C, H, W]; those of weight 0 are black."""
    read = batches.without_unread(views.detach()[None], aperture)[0]
    grey = torch.stack([batches.radiance(row).mean(1) for row in read]).cpu()
    batches.check_finite(grey, "mend the file, or give views weight 0")
    return grey


def grey_views(grey: Tensor, aperture: Tensor, positions: Tensor | None = None) -> GreyViews:
    """Grey views [V, U, H, W], those of weight 0 in the aperture [V, U] left out."""
    read, where, middle = _read_cameras(aperture, positions)
    samples = grey.float().flatten(0, 1)
    if len(read) < aperture.numel():
        samples = samples.index_select(0, on_device(read, grey.device))
    return GreyViews(samples, where, middle)


@on_host
def _read_cameras(aperture: Tensor, positions: Tensor | None) -> tuple[Tensor, Tensor, list[int]]:
    """Indices and positions of the views of a weight above 0, and the places of the middle ones among them."""
    read = (aperture.flatten() > 0).nonzero()[:, 0]
    if len(read) < 2:
        raise InputError("disparity takes more than one view", got=f"{len(read)} of a weight above 0")
    grid = (aperture.shape[0], aperture.shape[1])
    where = batches.even(grid) if positions is None else batches.checked_positions(positions, grid)
    where = where.flatten(0, 1)[read]
    distances = where.square().sum(1)
    nearest = (distances <= 1.01 * float(distances.min())).nonzero()[:, 0]  # equally near but for rounding
    return read, where, nearest.tolist()


def details(views: GreyViews, slopes: Tensor) -> GreyViews:
    """Square roots of the light, minus most of what a guided filter keeps of them; slopes [N] cover the scene.

    Roots weigh texture in shadows like texture in the light. Edges shrink but stay sharp: a plain high-pass filter
    would carry them into their neighbourhood. In noise beyond `CONTRAST` there is no finer texture to prefer.
    """
    roots = views._replace(samples=views.samples.clamp(min=0).sqrt())
    least = (CONTRAST * roots.samples.mean()).square()
    tiny = torch.finfo(torch.float32).tiny
    share = SHADING * least / (least + noise(roots, slopes).square()).clamp(min=tiny)
    # On a processor view by view: the filter takes some copies.
    parts = roots.samples.split(1 if is_known(share) else len(roots.samples))
    finer = []
    for root in parts:
        mean = neighbours.box_mean(root, 3)
        variance = (neighbours.box_mean(root.square(), 3) - mean.square()).clamp(min=0)
        kept = variance / (variance + least).clamp(min=tiny)
        finer.append(root - share * (neighbours.box_mean(kept, 3) * root + neighbours.box_mean((1 - kept) * mean, 3)))
    return roots._replace(samples=torch.cat(finer))


def noise(views: GreyViews, slopes: Tensor) -> Tensor:
    """Standard deviation of the differences of views where they show the same; slopes [N] cover the scene."""
    height = views.samples.shape[1]
    # Every eighth row and every second slope say enough. Rows are counted from both ends: mirrored views must have a
    # mirrored map.
    first = min(4, (height - 1) // 2)
    rows = torch.cat([torch.arange(first, (height + 1) // 2, 8), height - 1 - torch.arange(first, height // 2, 8)])
    # A spread of 1, far above all differences, turns shares into mean squares.
    level = torch.ones_like(views.samples[0])
    least = disagreements(views, slopes[::2], level, rows).amin(0).flatten()
    n_views = len(views.samples)
    quiet = least.sort().values.gather(0, (QUIET * (number(least.shape[0], least) - 1)).long()[None])[0]
    return (quiet * n_views / (n_views - 1)).clamp(min=0).sqrt()


def spread(views: GreyViews, noise: Tensor) -> Tensor:
    """sigma^2, the square of the difference that counts as half a disagreement, [H, W]."""
    return NOISY * noise.square() + LEAST_NOISE**2 + STEEP**2 * steepness(views.central)


def steepness(image: Tensor) -> Tensor:
    """Square of the gradient, averaged a little, [H, W]."""
    gradients = [neighbours.gradient(image, axis) for axis in (0, 1) if image.shape[axis] > 1]
    squares = sum((gradient.square() for gradient in gradients), torch.zeros_like(image))
    return neighbours.smoothed(squares[None], 1.0)[0]


class ViewTaps(NamedTuple):
    """How each view is read at one slope: cubic taps along both axes, and where it has samples."""

    rows: Integers
    """First row that is read for y = 0, [K]."""
    row_weights: Reals
    """[K, 4]."""
    row_spans: Integers
    """First row with samples, and one past the last, [K, 2]."""
    columns: Integers
    column_weights: Reals
    column_spans: Integers


def disagreements(views: GreyViews, slopes: Tensor, spread: Tensor, rows: Tensor | None = None) -> Tensor:
    """The cost volume at slopes [N]: the share of views that disagree, [N, R, W], in some rows [R] or in all.

    The spread [H, W] is the square of the difference that counts as half a disagreement.
    """
    if not is_known(views.samples):
        return _disagreements(views, slopes, spread, rows)
    samples, middle, positions = views.samples.numpy(), np.array(views.middle), views.positions.numpy()
    height, width = samples.shape[1:]
    chosen = np.arange(height) if rows is None else rows.numpy()
    shares = np.empty((len(slopes), len(chosen), width), np.float32)
    shifts = [
        ViewTaps(*_taps(slope * positions[:, 0], height), *_taps(slope * positions[:, 1], width))
        for slope in slopes.tolist()
    ]
    n_threads = loops.worthwhile(len(chosen) * width, 1 << 12)  # pixels of a slope from which one more thread pays
    level = spread.numpy()

    def work(n: int, first: int, last: int) -> None:
        part = slice(first, last)
        count_votes(samples, middle, shifts[n], level, chosen[part], shares[n, part])

    jobs = [(n, *band) for n in range(len(slopes)) for band in loops.bands(len(chosen), n_threads)]
    loops.share(work, jobs, n_threads)
    return torch.from_numpy(shares)


def _disagreements(views: GreyViews, slopes: Tensor, spread: Tensor, rows: Tensor | None) -> Tensor:
    """As `disagreements`, by PyTorch on any device, all slopes at once."""
    height, width = views.samples.shape[1:]
    positions = on_device(views.positions, slopes.device)
    down, across = (_near_whole(slopes[:, None] * axis) for axis in positions.unbind(1))  # [N, K]
    moved = moved_by_bands(views.samples, down, across, CUBIC, BORDERS["edge"])
    y, x = (torch.arange(length, device=slopes.device) for length in (height, width))
    exists = is_sampled(down[..., None], y, height)[..., None] & is_sampled(across[..., None], x, width)[..., None, :]
    if rows is not None:
        chosen = on_device(rows, slopes.device)
        moved, exists, spread = (part.index_select(-2, chosen) for part in (moved, exists, spread))
    present = exists.to(moved)
    # 1. The reference: mean of the central views that have a sample, 0 where none has.
    central, n_central = (torch.stack([part[:, k] for k in views.middle]).sum(0) for part in (moved * present, present))
    reference = (central / n_central.clamp(min=1))[:, None]
    # 2. The mean of all views, weighted by how well they agree with it.
    weights = present * spread / ((moved - reference).square() + spread)
    total = weights.sum(1, keepdim=True)
    reference = torch.where(total > 0, (weights * moved).sum(1, keepdim=True) / total, reference)
    # 3. The votes: the mean over all views with a sample; where none has, nothing agrees.
    squares = (moved - reference).square()
    count = present.sum(1)
    return torch.where(count > 0, (present * squares / (squares + spread)).sum(1) / count, 1.0)


def _near_whole(shifts: Tensor) -> Tensor:
    """Shifts; those that are whole but for rounding have the span of whole ones."""
    whole = shifts.round()
    return torch.where((shifts - whole).abs() < 1e-5, whole, shifts)


def _taps(shifts: NDArray, length: int) -> tuple[Integers, Reals, Integers]:
    """First sample read, weights and span of each view along one axis."""
    taps = [CUBIC.taps(float(shift)) for shift in shifts]
    starts = np.array([view[0][0] for view in taps], np.int64)
    weights = np.array([[weight for _, weight in view] for view in taps], np.float32)
    # Shifts that are whole but for rounding have the span of whole ones.
    near = np.where(np.abs(shifts - np.round(shifts)) < 1e-5, np.round(shifts), shifts)
    begins, ends = np.ceil(-near).clip(0, length), np.floor(length - 1 - near).clip(-1, length - 1) + 1
    return starts, weights, np.stack([begins, ends], 1).astype(np.int64)


@compiled
def count_votes(
    samples: Reals, middle: Integers, shifts: ViewTaps, spread: Reals, rows: Integers, shares: Reals
) -> None:  # pragma: no cover - compiled
    """One slope, some rows [R] of the cost volume: shares [R, W] are written, each in [0, 1]."""
    n_views, _, width = samples.shape
    moved, line = np.empty((n_views, width), np.float32), np.empty(width + 4, np.float32)
    reference, weights, total = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    # A row at a time: the shifted rows of all views stay in the cache, and each pass over x becomes vector code.
    for i in range(rows.size):
        y = rows[i]
        present = np.flatnonzero((shifts.row_spans[:, 0] <= y) & (y < shifts.row_spans[:, 1]))
        # 1. Read the views.
        for k in present:
            _read_row(samples[k], shifts, k, y, line, moved[k])
        # 2. The reference: mean of the central views that have a sample, 0 where none has.
        reference[:] = 0
        weights[:] = 0
        for k in present:
            if (middle == k).any():
                begin, end = shifts.column_spans[k]
                view, mean, count = moved[k, begin:end], reference[begin:end], weights[begin:end]
                for x in range(view.size):
                    mean[x] += view[x]
                    count[x] += np.float32(1)
        for x in range(width):
            reference[x] /= max(weights[x], np.float32(1))
        # 3. The mean of all views, weighted by how well they agree with it.
        weights[:] = 0
        total[:] = 0
        for k in present:
            begin, end = shifts.column_spans[k]
            _add_agreement(
                moved[k, begin:end], spread[y, begin:end], reference[begin:end], weights[begin:end], total[begin:end]
            )
        for x in range(width):
            if weights[x] > 0:
                reference[x] = total[x] / weights[x]
        # 4. The votes: the mean over all views with a sample; where none has, nothing agrees.
        weights[:] = 0
        shares[i] = 0
        for k in present:
            begin, end = shifts.column_spans[k]
            _add_votes(
                moved[k, begin:end],
                spread[y, begin:end],
                reference[begin:end],
                weights[begin:end],
                shares[i, begin:end],
            )
        for x in range(width):
            shares[i, x] = shares[i, x] / weights[x] if weights[x] > 0 else np.float32(1)


@inlined
def _read_row(view: Reals, shifts: ViewTaps, k: int, y: int, line: Reals, moved: Reals) -> None:
    """Row y of a shifted view where it has samples: first four rows to a line, then four columns of it to a sample."""
    height, width = view.shape
    top, (a, b, c, d) = y + shifts.rows[k], shifts.row_weights[k]
    # Taps beyond the border read its outermost row and, below, column.
    first, second = view[min(max(top, 0), height - 1)], view[min(max(top + 1, 0), height - 1)]
    third, fourth = view[min(max(top + 2, 0), height - 1)], view[min(max(top + 3, 0), height - 1)]
    inner = line[2 : 2 + width]
    for x in range(width):
        inner[x] = a * first[x] + b * second[x] + c * third[x] + d * fourth[x]
    line[:2], line[2 + width :] = inner[0], inner[width - 1]
    begin, end = shifts.column_spans[k]
    read, out = line[begin + 2 + shifts.columns[k] :], moved[begin:end]
    a, b, c, d = shifts.column_weights[k]
    for x in range(out.size):
        out[x] = a * read[x] + b * read[x + 1] + c * read[x + 2] + d * read[x + 3]


# Not inlined: loops this short over whole rows are compiled to vector instructions on their own.
@compiled
def _add_agreement(view: Reals, spread: Reals, reference: Reals, weights: Reals, total: Reals) -> None:
    for x in range(view.size):
        off = view[x] - reference[x]
        weight = spread[x] / (off * off + spread[x])
        weights[x] += weight
        total[x] += weight * view[x]


@compiled
def _add_votes(view: Reals, spread: Reals, reference: Reals, counts: Reals, shares: Reals) -> None:
    for x in range(view.size):
        off = view[x] - reference[x]
        square = off * off
        shares[x] += square / (square + spread[x])
        counts[x] += np.float32(1)


# The same robust mean at one pixel, for views read between their samples by cubic splines (`matching.refine`,
# `extended_focus`): slower than the sweep, sharper than its four taps.


@inlined
def read_spline(view: Reals, p: float, q: float) -> tuple[Number, Number, Number]:
    """A view, given as spline coefficients [H, W], at a position within it, and its derivatives along y and x."""
    height, width = view.shape
    row, column = int(p), int(q)
    (a, b, c, d), (da, db, dc, dd) = _spline(np.float32(p - row))
    (e, f, g, h), (de, df, dg, dh) = _spline(np.float32(q - column))
    left, right, after = abs(column - 1), _mirrored(column + 1, width), _mirrored(column + 2, width)
    value = along_y = along_x = np.float32(0)
    for n in range(4):
        line = view[_mirrored(row - 1 + n, height)]
        first, second, third, fourth = line[_mirrored(left, width)], line[column], line[right], line[after]
        here = e * first + f * second + g * third + h * fourth
        change = de * first + df * second + dg * third + dh * fourth
        # Chains of conditions: a table of weights would go through memory.
        weight = a if n == 0 else b if n == 1 else c if n == 2 else d
        derivative = da if n == 0 else db if n == 1 else dc if n == 2 else dd
        value += weight * here
        along_y += derivative * here
        along_x += weight * change
    return value, along_y, along_x


@inlined
def _mirrored(index: int, length: int) -> int:
    """Index beyond both ends to the mirrored one within, as in `splines.coefficients`."""
    index = abs(index)
    return max(2 * (length - 1) - index, 0) if index >= length else index


@inlined
def _spline(t: float) -> tuple[Taps, Taps]:
    """Weights of the coefficients at -1, 0, 1 and 2 of a cubic B-spline, and of its derivative."""
    rest, sixth, half = np.float32(1) - t, np.float32(1 / 6), np.float32(0.5)
    first, last = rest * rest * rest * sixth, t * t * t * sixth
    second = np.float32(2 / 3) - half * t * t * (np.float32(2) - t)
    slope_first, slope_last = -half * rest * rest, half * t * t
    slope_second = t * (np.float32(1.5) * t - np.float32(2))
    # Weights sum to 1, those of the derivative to 0: the third follows.
    return (first, second, np.float32(1) - first - second - last, last), (
        slope_first,
        slope_second,
        -slope_first - slope_second - slope_last,
        slope_last,
    )


@inlined
def mean_of(values: Reals, middle: Integers) -> Number:
    """Mean of the central values that are not NaN, 0 if all are."""
    total, count = np.float32(0), np.float32(0)
    for i in range(middle.size):
        value = values[middle[i]]
        if not math.isnan(value):
            total += value
            count += np.float32(1)
    return total / max(count, np.float32(1))


@inlined
def robust_mean(values: Reals, reference: Number, spread: float, weights: Reals) -> Number:
    """Mean of the values weighted by their agreement with a reference; weights are written, 0 for NaN.

    The weights are the squares of the agreement in the sweep, so that views that differ count for next to nothing.
    """
    total, sum_of_weights = np.float32(0), np.float32(0)
    for k in range(values.size):
        off = values[k] - reference
        weight = spread / (spread + off * off)
        weights[k] = weight * weight if weight > 0 else np.float32(0)  # NaN is not above 0
        if weight > 0:
            total += weights[k] * values[k]
            sum_of_weights += weights[k]
    return total / sum_of_weights if sum_of_weights > 0 else reference
