"""What matching looks at: the grey views that are to be read, one after the other, and where each stands.

Letters: `K` views that are read, `v u` view row and column from the angular centre.
"""

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.errors import InputError
from lfref.functional import neighbours, threads
from lfref.functional.jit import compiled, inlined
from lfref.refocus import batches, lines
from lfref.refocus.sampling import INTERPOLATIONS

# PART agreement_loop
# The compiled loop of `agreement`: one slope, one band of rows, the views shifted and compared a row at a time.
#
# Letters: `k` view, `y x` pixel row and column, `r` what views are compared with.

Reals = NDArray[np.float32]
Integers = NDArray[np.int64]


class Shifts(NamedTuple):
    """How each view is read at one slope: cubic taps along both axes, and where it has samples."""

    rows: Integers
    """First row that is read for y = 0, [K]."""
    row_weights: Reals
    """[K, 4]."""
    row_spans: Integers
    """First row served, and one past the last, [K, 2]."""
    columns: Integers
    """As `rows`, [K]."""
    column_weights: Reals
    """[K, 4]."""
    column_spans: Integers
    """[K, 2]."""


@compiled
def disagree_of_agreement_loop(
    samples: Reals, middle: Integers, shifts: Shifts, spread: Reals, rows: Integers, shares: Reals
) -> None:
    """The share of views, softly counted, that show something else than most of them do.

    Args:
        samples: Grey views, [K, H, W].
        middle: Those to compare with at first.
        shifts: How they are read.
        spread: Square of the difference that counts as half a disagreement, [H, W].
        rows: Rows to look at, [R].
        shares: Filled, in [0, 1], [R, W].
    """
    n_views, _, width = samples.shape
    moved, line = np.empty((n_views, width), np.float32), np.empty(width + 4, np.float32)
    reference, weights, total = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    for i in range(rows.size):
        y = rows[i]
        served = np.flatnonzero((shifts.row_spans[:, 0] <= y) & (y < shifts.row_spans[:, 1]))
        for k in served:
            _move(samples[k], shifts, k, y, line, moved[k])
        _average(moved, middle, served, shifts, reference, weights)
        _agree(moved, served, shifts, spread[y], reference, weights, total)
        _compare(moved, served, shifts, spread[y], reference, weights, shares[i])


@inlined
def _move(view: Reals, shifts: Shifts, k: int, y: int, line: Reals, moved: Reals) -> None:
    """Row y of a shifted view, where it has samples."""
    height, width = view.shape
    top, (a, b, c, d) = y + shifts.rows[k], shifts.row_weights[k]
    first, second = view[min(max(top, 0), height - 1)], view[min(max(top + 1, 0), height - 1)]
    third, fourth = view[min(max(top + 2, 0), height - 1)], view[min(max(top + 3, 0), height - 1)]
    inner = line[2 : 2 + width]
    for x in range(width):
        inner[x] = a * first[x] + b * second[x] + c * third[x] + d * fourth[x]
    line[:2], line[2 + width :] = inner[0], inner[width - 1]
    begin, end = shifts.column_spans[k]
    read, made = line[begin + 2 + shifts.columns[k] :], moved[begin:end]
    a, b, c, d = shifts.column_weights[k]
    for x in range(made.size):
        made[x] = a * read[x] + b * read[x + 1] + c * read[x + 2] + d * read[x + 3]


@inlined
def _average(moved: Reals, middle: Integers, served: Integers, shifts: Shifts, reference: Reals, counts: Reals) -> None:
    """The mean of those views in the middle that have a sample; 0 where none has."""
    reference[:] = 0
    counts[:] = 0
    for k in served:
        if (middle == k).any():
            begin, end = shifts.column_spans[k]
            view, mean, count = moved[k, begin:end], reference[begin:end], counts[begin:end]
            for x in range(view.size):
                mean[x] += view[x]
                count[x] += np.float32(1)
    for x in range(reference.size):
        reference[x] /= max(counts[x], np.float32(1))


@inlined
def _agree(
    moved: Reals, served: Integers, shifts: Shifts, spread: Reals, reference: Reals, weights: Reals, total: Reals
) -> None:
    """Replace the reference by the mean of the views that agree with it: less noise, and no view is special."""
    weights[:] = 0
    total[:] = 0
    for k in served:
        begin, end = shifts.column_spans[k]
        _add_agreement(
            moved[k, begin:end], spread[begin:end], reference[begin:end], weights[begin:end], total[begin:end]
        )
    for x in range(reference.size):
        if weights[x] > 0:
            reference[x] = total[x] / weights[x]


@compiled
def _add_agreement(view: Reals, spread: Reals, reference: Reals, weights: Reals, total: Reals) -> None:
    for x in range(view.size):
        off = view[x] - reference[x]
        weight = spread[x] / (off * off + spread[x])
        weights[x] += weight
        total[x] += weight * view[x]


@inlined
def _compare(
    moved: Reals, served: Integers, shifts: Shifts, spread: Reals, reference: Reals, counts: Reals, shares: Reals
) -> None:
    """Count those that differ, of all that have a sample; nothing agrees where none has."""
    counts[:] = 0
    shares[:] = 0
    for k in served:
        begin, end = shifts.column_spans[k]
        _add_difference(
            moved[k, begin:end], spread[begin:end], reference[begin:end], counts[begin:end], shares[begin:end]
        )
    for x in range(shares.size):
        shares[x] = shares[x] / counts[x] if counts[x] > 0 else np.float32(1)


@compiled
def _add_difference(view: Reals, spread: Reals, reference: Reals, counts: Reals, shares: Reals) -> None:
    for x in range(view.size):
        off = view[x] - reference[x]
        square = off * off
        shares[x] += square / (square + spread[x])
        counts[x] += np.float32(1)


SAME_DISTANCE = 1.01
"""Views whose distances from the centre are within this ratio are equally near."""


class GreyViews(NamedTuple):
    """The views of one light field."""

    samples: NDArray[np.float32]
    """[K, H, W]."""
    places: NDArray[np.float32]
    """v and u of each, in view steps from the angular centre, [K, 2]."""
    middle: NDArray[np.int64]
    """Which of them are nearest to the angular centre: one, or those around it."""

    @property
    def central(self) -> Tensor:
        """The picture in the middle, [H, W]."""
        return torch.from_numpy(self.samples[self.middle].mean(0))


def grey_views(views: Tensor, aperture: Tensor, positions: Tensor | None = None) -> GreyViews:
    """The views of a light field in grey, those of weight 0 left out.

    Args:
        views: Floating point, uint8 or uint16, [V, U, C, H, W].
        aperture: Weight of each view, [V, U].
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Raises:
        InputError: Views that are not finite, or less than two that are to be read.
    """
    is_read = aperture > 0
    if int(is_read.sum()) < 2:
        raise InputError("disparity takes more than one view", got=f"{int(is_read.sum())} of a weight above 0")
    light = [batches.radiance(view).mean(0).float().cpu() for view in views.detach()[is_read.to(views.device)]]
    samples = torch.stack(light)
    if not bool(samples.isfinite().all()):
        raise InputError("views must be finite", got="NaN or infinity", remedy="mend the file, or give views weight 0")
    grid = batches.grid_and_size(views)[0]
    places = (lines.even(grid) if positions is None else lines.checked_positions(positions, grid))[is_read]
    distances = places.square().sum(1)
    nearest = (distances <= SAME_DISTANCE * float(distances.min())).nonzero()[:, 0]
    return GreyViews(samples.numpy(), places.float().numpy(), nearest.numpy())


# PART agreement
# How far views disagree at each slope: the share of them that show something else than the central view does.
#
# Every view counts as one vote, softly: a difference far beyond noise is one whole disagreement however great it is. So
# the views from which a nearer surface hides the point outvote nobody, wherever in the aperture they are, and a bright
# edge weighs no more than weak texture.
# Letters: `s` slope in pixels per view step, `N` slopes tried.
# Source: Black, Rangarajan, "On the Unification of Line Processes, Outlier Rejection, and Robust Statistics", 1996
# (Geman-McClure's function of the difference).

LEAST_NOISE = 1e-3
"""Standard deviation that even good views have: rounding to 8 bits gives as much."""
NOISY = 2.0
"""Squares of the noise that a difference may have before it counts as half a disagreement."""
STEEP = 0.05
"""Pixels by which slopes between those that are tried shift a view that matters."""
QUIET = 0.25
"""Share of pixels that show nothing but noise at their best slope: others are interpolated, hidden, or shine."""
SAMPLED = 8
"""Of so many rows one says how much noise there is; and every second slope."""
WORTH_A_THREAD = 1 << 12
"""Pixels at one slope from which one more thread saves more than it costs."""


def noise(views: GreyViews, slopes: Tensor) -> float:
    """Standard deviation of what distinguishes views that show the same.

    Args:
        views: The views.
        slopes: Slopes of which one is about right for each pixel, in pixels per view step, [N].
    """
    height = views.samples.shape[1]
    # Alike from above and from below: mirrored views have a mirrored map.
    to_border = np.minimum(np.arange(height), np.arange(height)[::-1])
    rows = np.flatnonzero(to_border % SAMPLED == min(SAMPLED // 2, to_border.max()))
    # A spread far above all differences makes shares of them squares.
    even = np.ones(views.samples.shape[1:], np.float32)
    least = disagreements(views, slopes[::2], even, rows).amin(0)
    n_views = len(views.samples)
    quiet = float(least.flatten().kthvalue(1 + int(QUIET * (least.numel() - 1))).values)
    return max(quiet * n_views / (n_views - 1), 0.0) ** 0.5


def spread(views: GreyViews, noise: float) -> Tensor:
    """Square of the difference that counts as half a disagreement, [H, W].

    Args:
        views: The views.
        noise: Standard deviation of one.
    """
    return NOISY * noise**2 + LEAST_NOISE**2 + STEEP**2 * steepness(views.central)


def steepness(image: Tensor) -> Tensor:
    """Square of the gradient, averaged a little, [H, W]."""
    gradients = [torch.gradient(image, dim=axis)[0] for axis in (0, 1) if image.shape[axis] > 1]
    squares = sum((gradient.square() for gradient in gradients), torch.zeros_like(image))
    return neighbours.smoothed(squares[None], 1.0)[0]


def disagreements(
    views: GreyViews, slopes: Tensor, spread: NDArray[np.float32], rows: NDArray[np.int64] | None = None
) -> Tensor:
    """The share of views that disagree, [N, R, W].

    Args:
        views: The views.
        slopes: In pixels per view step, [N].
        spread: Square of the difference that counts as half a disagreement, [H, W].
        rows: Rows to look at, [R]; None looks at all.
    """
    height, width = views.samples.shape[1:]
    chosen = np.arange(height) if rows is None else rows
    shares = np.empty((len(slopes), len(chosen), width), np.float32)
    shifts = [_shifts(views, slope) for slope in slopes.tolist()]
    n_threads = threads.worthwhile(len(chosen) * width, WORTH_A_THREAD)

    def disagree(n: int, band: tuple[int, int]) -> None:
        part = slice(*band)
        disagree_of_agreement_loop(views.samples, views.middle, shifts[n], spread, chosen[part], shares[n, part])

    jobs = [(n, band) for n in range(len(slopes)) for band in threads.bands(len(chosen), n_threads)]
    threads.share(disagree, jobs, n_threads)
    return torch.from_numpy(shares)


def _shifts(views: GreyViews, slope: float) -> Shifts:
    height, width = views.samples.shape[1:]
    return Shifts(*_along(slope * views.places[:, 0], height), *_along(slope * views.places[:, 1], width))


def _along(shifts: NDArray, length: int) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.int64]]:
    """First sample read, weights and span of each view along one axis."""
    taps = [INTERPOLATIONS["cubic"].taps(float(shift)) for shift in shifts]
    starts = np.array([view[0][0] for view in taps], np.int64)
    weights = np.array([[weight for _, weight in view] for view in taps], np.float32)
    # Shifts that are whole but for rounding serve what they would serve if they were.
    near = np.where(np.abs(shifts - np.round(shifts)) < 1e-5, np.round(shifts), shifts)
    begins, ends = np.ceil(-near).clip(0, length), np.floor(length - 1 - near).clip(-1, length - 1) + 1
    return starts, weights, np.stack([begins, ends], 1).astype(np.int64)
