"""A picture that is sharp everywhere: at each pixel the mean of the views that show the same point.

Views are read at the disparity of each pixel. Those that show something else there, because a nearer surface hides the
point from them, do not count: edges stay clean, and there are as few copies at borders as within. All others average
their noise out, which is what the picture has over the central view.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.errors import InputError
from lfref.functional import neighbours, splines, threads
from lfref.functional.jit import compiled
from lfref.functional.neighbours import box_max
from lfref.refocus import batches
from lfref.refocus.disparity import agreement
from lfref.refocus.disparity.agreement import GreyViews
from lfref.refocus.disparity.disparity_map import disparity_map
from lfref.refocus.disparity.steps_loop import Integers, Reals, mean_of, read_spline, weigh
from lfref.refocus.shift.shift_and_sum import shift_and_sum

# PART mean_loop
# The compiled loop of `extended_focus`: at each pixel the mean of the views that show its point.
#
# Letters: `k` view, `c` channel, `y x` pixel row and column.


@compiled
def weigh_views(
    coefficients: Reals,
    places: Reals,
    middle: Integers,
    disparity: Reals,
    spread: Reals,
    top: int,
    weights: NDArray[np.float32],
) -> None:
    """How far each view shows the point at each pixel of a band of rows.

    Args:
        coefficients: Cubic splines through grey views, [K, H, W].
        places: v and u of each view, [K, 2].
        middle: Views to compare with at first.
        disparity: In pixels per view step, [H, W].
        spread: Square of the difference that counts as half a disagreement, [H, W].
        top: First row of the band.
        weights: Filled, 0 of views without a sample there, else up to 1, [R, W, K].
    """
    n_views, height, width = coefficients.shape
    values = np.empty(n_views, np.float32)
    for i in range(weights.shape[0]):
        y = top + i
        for x in range(width):
            for k in range(n_views):
                p, q = y + disparity[y, x] * places[k, 0], x + disparity[y, x] * places[k, 1]
                values[k] = np.nan
                if 0 <= p <= height - 1 and 0 <= q <= width - 1:
                    values[k] = read_spline(coefficients[k], p, q)[0]
            reference = weigh(values, mean_of(values, middle), spread[y, x], weights[i, x])
            weigh(values, reference, spread[y, x], weights[i, x])


@compiled
def add_views(
    coefficients: Reals, places: Reals, disparity: Reals, weights: Reals, top: int, picture: NDArray[np.float32]
) -> None:
    """One channel of the weighted mean of a band of rows.

    Args:
        coefficients: Cubic splines through this channel of the views, [K, H, W].
        places: v and u of each view, [K, 2].
        disparity: In pixels per view step, [H, W].
        weights: As `weigh_views` leaves them, [R, W, K].
        top: First row of the band.
        picture: Filled, 0 where no view has a sample, [R, W].
    """
    for i in range(picture.shape[0]):
        y = top + i
        for x in range(picture.shape[1]):
            total, sum_of_weights = np.float32(0), np.float32(0)
            for k in range(len(coefficients)):
                weight = weights[i, x, k]
                if weight > 0:
                    p, q = y + disparity[y, x] * places[k, 0], x + disparity[y, x] * places[k, 1]
                    total += weight * read_spline(coefficients[k], p, q)[0]
                    sum_of_weights += weight
            picture[i, x] = total / max(sum_of_weights, np.float32(1e-12))


WORTH_A_THREAD = 1 << 10
"""Pixels from which one more thread saves more than it costs."""


@torch.no_grad()
def extended_focus(
    views: Tensor, disparity: Tensor | None = None, weights: Tensor | None = None, positions: Tensor | None = None
) -> Tensor:
    """Make the picture of the central view with the light of all of them, on the CPU.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W], more than one view.
        disparity: Of each pixel of the central view, in pixels per view step, [..., H, W]; None has it found.
        weights: Which views to look at: those of weight 0 are not, [V, U]; None looks at all.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Returns:
        Sharp pictures in the type (float32 for integers) and on the device of the views, [..., C, H, W]. No gradients.

    Raises:
        InputError: Views, a map, weights or positions that cannot be used.

    Example:
        >>> views = torch.rand(5, 5, 3, 48, 64)
        >>> lfref.extended_focus(views).shape
        torch.Size([3, 48, 64])
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    aperture = batches.checked_weights(weights, grid)
    maps = disparity_map(views, weights=weights, positions=positions).disparity if disparity is None else disparity
    _check(maps, (*views.shape[:-5], *size))
    maps = maps.detach().float().cpu().reshape(-1, *size)
    pictures = [_picture(field, aperture, positions, map_) for field, map_ in zip(batch, maps, strict=True)]
    made = torch.stack(pictures).reshape(*views.shape[:-5], *views.shape[-3:])
    return made.to(views.device, batches.stack_dtype(views))


def _check(disparity: Tensor, shape: tuple[int, ...]) -> None:
    if tuple(disparity.shape) != shape:
        raise InputError(f"disparity must be {list(shape)}, a number a pixel", got=f"shape {list(disparity.shape)}")
    if not bool(disparity.isfinite().all()):
        raise InputError("disparity must be finite", got="NaN or infinity", remedy="fill what is missing first")


def _picture(views: Tensor, aperture: Tensor, positions: Tensor | None, disparity: Tensor) -> Tensor:
    """One light field [V, U, C, H, W] as one picture [C, H, W]."""
    light = agreement.grey_views(views, aperture, positions)
    places, weights = disparity.numpy(), _weights(light, disparity)
    read = views.detach()[(aperture > 0).to(views.device)]
    channels = [
        _mean(batches.radiance(channel).float().cpu().contiguous(), light, places, weights)
        for channel in read.unbind(1)
    ]
    return torch.stack(channels)


def _weights(light: GreyViews, disparity: Tensor) -> np.ndarray:
    """How far each view shows the point at each pixel, [H, W, K]."""
    noise = agreement.noise(light, torch.linspace(float(disparity.min()), float(disparity.max()), 9))
    spread, coefficients = agreement.spread(light, noise).numpy(), splines.coefficients(light.samples)
    weights, places = np.empty((*disparity.shape, len(light.samples)), np.float32), disparity.numpy()

    def weigh(top: int, end: int) -> None:
        part = weights[top:end]
        weigh_views(coefficients, light.places, light.middle, places, spread, top, part)

    _in_bands(weigh, disparity.shape)
    return weights


def _mean(channel: Tensor, light: GreyViews, disparity: np.ndarray, weights: np.ndarray) -> Tensor:
    """One channel of the views, [K, H, W], as one of the picture, [H, W]."""
    coefficients, picture = splines.coefficients(channel.numpy()), np.empty_like(disparity)

    def add(top: int, end: int) -> None:
        add_views(coefficients, light.places, disparity, weights[top:end], top, picture[top:end])

    _in_bands(add, disparity.shape)
    return torch.from_numpy(picture)


def _in_bands(work: Callable[[int, int], None], size: Sequence[int]) -> None:
    n_threads = threads.worthwhile(size[0] * size[1], WORTH_A_THREAD)
    threads.share(work, threads.bands(size[0], n_threads), n_threads)


# PART nearer
# Which disparities are nearer: what hides is in front of what is hidden.
#
# Cameras that stand as they are counted see near points move against their own way, so that smaller disparities are
# nearer; where both axes of views are counted the other way, larger ones are. Next to the edge of a surface in front,
# one
# half of the aperture sees what the other does not: views of that half agree, at the disparity of what is behind.
# Whether disparities around are larger or smaller than that one is counted over the picture.
# Only the middle row and the middle column of views are looked at.
# Letters: `s` slope in pixels per view step, `N` slopes tried, `n` views of a line.

STEP = 0.1  # between the slopes tried, in pixels per view step
RADIUS = 1.0  # standard deviation of the window in which views are compared, in pixels
AROUND = 3  # pixels: so near to a pixel the surface that hides it must show, and its own too
UNLIKE = 6.0  # times as much the hidden half must disagree
SURE = 0.8  # confidence of the half that sees
FAINTEST = 1e-4  # variance over all slopes below which there is no texture to tell anything by
FLOOR = 1e-6  # variance of views that agree as well as 8 bits can say
NOTABLE, OWN = 0.35, 0.1  # of the range of disparities: least step that counts, and what still is the same surface
LEAST_PIXELS, LEAST_SCORE = 30, 0.5
OUTLIERS = 0.01  # of the disparities that are sure, at either end
MARGIN = 8  # pixels at the borders, where views end


class _Half(NamedTuple):
    """What the views on one side of the centre of a line say."""

    cost: Tensor
    """Their variance at each slope, [N, H, W]."""
    least: Tensor
    """The least of it, [1, H, W]."""
    best: Tensor
    """Which slope has it, [1, H, W]."""


@torch.no_grad()
def nearer_sign(views: Tensor, disparity: Tensor, confidence: Tensor) -> int:
    """Tell by what hides what whether larger or smaller disparities are nearer.

    Args:
        views: Floating point, uint8 or uint16, [V, U, C, H, W].
        disparity: Of each pixel of the central view, in pixels per view step, [H, W].
        confidence: Of the disparity, [0, 1], [H, W].

    Returns:
        1 if larger disparities are nearer, -1 if smaller ones are, 0 where nothing clearly hides anything.
    """
    sure = disparity[confidence > SURE / 2]
    if sure.numel() < LEAST_PIXELS:
        return 0
    ordered = sure.double().sort().values
    first, last = (float(ordered[round(share * (len(ordered) - 1))]) for share in (OUTLIERS, 1 - OUTLIERS))
    light = batches.radiance(views).mean(2, keepdim=True)
    middle_row, middle_column = light[None, light.shape[0] // 2], light[:, None, light.shape[1] // 2]
    steps = torch.cat([_steps(line, disparity, first - STEP, last + STEP) for line in (middle_row, middle_column)])
    if len(steps) < LEAST_PIXELS:
        return 0
    score = float(steps.sum() / steps.abs().sum())
    return int(math.copysign(1, score)) if abs(score) > LEAST_SCORE else 0


def _steps(line: Tensor, disparity: Tensor, first: float, last: float) -> Tensor:
    """From what is hidden in one half of a line of views to what is around it: notable steps of disparity, [P]."""
    if max(line.shape[:2]) < 3 or min(line.shape[-2:]) <= 2 * MARGIN:
        return line.new_zeros(0)
    slopes = torch.linspace(first, last, 1 + math.ceil((last - first) / STEP), dtype=torch.float64)
    one, other = (_half(line, slopes, side) for side in (1, -1))
    is_one = one.least < other.least
    hidden = torch.where(is_one, other.cost.gather(0, one.best), one.cost.gather(0, other.best))[0]
    seen = torch.where(is_one, one.least, other.least)[0]
    mean = torch.where(is_one[0], one.cost.mean(0), other.cost.mean(0))
    rise, fall = _around(disparity.to(line), slopes.to(line)[torch.where(is_one, one.best, other.best)[0]])
    step = rise.clamp(min=0) - fall.clamp(min=0)
    is_hidden = (hidden > UNLIKE * seen) & (seen < (1 - SURE) * mean) & (mean > FAINTEST)
    is_hidden &= step.abs() > NOTABLE * (last - first)
    is_hidden &= torch.minimum(rise.abs(), fall.abs()) < max(STEP, OWN * (last - first))
    inside = slice(MARGIN, -MARGIN)
    return step[inside, inside][is_hidden[inside, inside]]


def _half(line: Tensor, slopes: Tensor, side: int) -> _Half:
    """The views of a line [1, n, 1, H, W] or [n, 1, 1, H, W] on one side of its centre."""
    places = torch.arange(max(line.shape[:2]), dtype=torch.float64) - (max(line.shape[:2]) - 1) / 2
    weights = (side * places >= 0).double().reshape(line.shape[:2])
    light = torch.cat([line, line.square()], 2)
    mean, square = shift_and_sum(light, slopes, "cubic", weights=weights).unbind(1)
    cost = neighbours.smoothed((square - mean.square()).clamp(min=0), RADIUS) + FLOOR
    return _Half(cost, *cost.min(0, keepdim=True))


def _around(disparity: Tensor, here: Tensor) -> tuple[Tensor, Tensor]:
    """How far disparities around a pixel reach above and below one of its own, [H, W] each."""
    most, least = (sign * box_max(sign * disparity, 2 * AROUND + 1) for sign in (1, -1))
    return most - here, here - least
