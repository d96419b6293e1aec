"""The compiled loop of `relaxing`: all rows of a map solved at once, each with its neighbours where they were.

Letters: `y x` pixel row and column.
"""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.functional import neighbours, splines, threads
from lfref.functional.jit import compiled, inlined
from lfref.refocus.disparity import agreement, steps_loop
from lfref.refocus.disparity.agreement import GreyViews

# PART paths_loop
# The compiled loop of `paths`: the cheapest way to each pixel along lines of one direction.
#
# Letters: `n` label, `y x` pixel row and column.

Reals = NDArray[np.float32]


@compiled
def add_paths(costs: Reals, jumps: Reals, change: float, down: int, right: int, total: Reals) -> None:
    """Add what the cheapest way along a direction costs that ends at each pixel with each label.

    Args:
        costs: Of each label, [H, W, N].
        jumps: What a change by more than one label costs between a pixel and the one before it, [H, W].
        change: What a change by one label costs.
        down: Step of the direction along y: -1, 0 or 1.
        right: Step along x; along y it must be 0 or else the first.
        total: Added to, [H, W, N].
    """
    height, width, n_labels = costs.shape
    before, here = np.zeros((width, n_labels), np.float32), np.zeros((width, n_labels), np.float32)
    for i in range(height):
        y = i if down >= 0 else height - 1 - i
        for j in range(width):
            x = j if right >= 0 else width - 1 - j
            previous = x - right
            if 0 <= previous < width and (down == 0 or i > 0):
                way = here[previous] if down == 0 else before[previous]
                _go_on(costs[y, x], way, np.float32(change), jumps[y, x], here[x])
            else:
                here[x] = costs[y, x]
            for n in range(n_labels):
                total[y, x, n] += here[x, n]
        if down != 0:
            before, here = here, before


@inlined
def _go_on(costs: Reals, way: Reals, change: float, jump: float, here: Reals) -> None:
    """The way one pixel on: stay, change by one label, or jump; less the least before, so that numbers stay small."""
    n_labels, least = costs.size, way.min()
    farther = least + jump
    for n in range(n_labels):
        here[n] = min(way[n], farther)
    for n in range(1, n_labels):
        here[n] = min(here[n], way[n - 1] + change)
    for n in range(n_labels - 1):
        here[n] = min(here[n], way[n + 1] + change)
    for n in range(n_labels):
        here[n] += costs[n] - least


# PART paths
# One map of many costs: labels that are cheap at their pixels and seldom change from pixel to pixel.
#
# The energy of a whole map cannot be minimised, that of a line can: each pixel takes the label that is cheapest over
# the
# lines that reach it from eight directions. A change by one label, as on a slant, costs little; a jump costs more, and
# less where the picture has an edge.
# Letters: `N` labels, `H W` height and width.
# Source: Hirschmueller, "Stereo Processing by Semiglobal Matching and Mutual Information", 2008.

CHANGE = 0.3
"""Price of a change by one label, in costs of one pixel that is wholly wrong."""
JUMP = 1.5
"""Price of a jump where the picture is even."""
EDGE = 1.5
"""Mean differences between neighbours at which a jump costs half as much."""
DIRECTIONS = (((0, 1), (0, -1), (1, 1), (-1, -1)), ((1, 0), (-1, 0), (1, -1), (-1, 1)))
"""Steps along y and x, in two parts that can be followed at the same time: their sum must not depend on threads."""


def along_paths(costs: Tensor, picture: Tensor) -> Tensor:
    """Costs that take the neighbours into account, all directions together, [N, H, W].

    Args:
        costs: Of each label at each pixel, in [0, 1], float32, CPU, [N, H, W].
        picture: Says where edges are, [H, W].
    """
    last = np.ascontiguousarray(costs.permute(1, 2, 0).numpy())
    totals = [np.zeros_like(last) for _ in DIRECTIONS]

    def follow(part: int) -> None:
        for down, right in DIRECTIONS[part]:
            add_paths(last, _jumps(picture, down, right), CHANGE, down, right, totals[part])

    threads.share(follow, [(part,) for part in range(len(DIRECTIONS))], torch.get_num_threads())
    return torch.from_numpy(sum(totals[1:], totals[0])).permute(2, 0, 1).contiguous()


def _jumps(picture: Tensor, down: int, right: int) -> np.ndarray:
    """Price of a jump from the pixel before, [H, W]; what has none before it is never asked."""
    differences = (picture - picture.roll((down, right), (0, 1))).abs()
    neighbours = [picture.diff(dim=axis).abs().flatten() for axis in (0, 1)]
    usual = torch.cat(neighbours).mean() if picture.numel() > 1 else picture.new_ones(())
    steepness = differences / (EDGE * usual.clamp(min=torch.finfo(usual.dtype).tiny))
    return (JUMP / (1 + steepness)).clamp(min=CHANGE).float().numpy()


# PART labels
# Disparities in steps: the slope of each pixel among those tried, and how clearly it is the best.
#
# Letters: `s` slope in pixels per view step, `N` slopes tried.

STEP = 0.1
"""Between slopes, in pixels per view step: `refining` finds what lies between them."""
FLOOR = 1e-3
"""Share of disagreeing views that is as good as none."""


def slopes_between(first: float, last: float) -> Tensor:
    """Slopes to try, at most a step apart, float64, [N]."""
    return torch.linspace(first, last, 1 + math.ceil((last - first) / STEP - 1e-9), dtype=torch.float64)


def best_slopes(views: GreyViews, slopes: Tensor, noise: float, radius: float) -> tuple[Tensor, Tensor]:
    """The slope of each pixel and its confidence, [H, W] each.

    Args:
        views: The views.
        slopes: Slopes tried, evenly spaced, in pixels per view step, [N].
        noise: Standard deviation of a view.
        radius: Standard deviation of the window in which views are compared, in pixels.
    """
    spread = agreement.spread(views, noise).numpy()
    shares = neighbours.smoothed(agreement.disagreements(views, slopes, spread), radius)
    costs = along_paths(shares, views.central)
    best = costs.argmin(0, keepdim=True)
    step = float(slopes[1] - slopes[0]) if len(slopes) > 1 else 0.0
    disparity = float(slopes[0]) + step * (best + _least(costs, best))[0]
    least, mean = shares.gather(0, best)[0], shares.mean(0)
    return disparity, ((mean - least) / (mean + FLOOR)).clamp(min=0)


def _least(costs: Tensor, best: Tensor) -> Tensor:
    """Where a parabola through the least cost and its neighbours has its least, in slopes from it, [1, H, W]."""
    last = len(costs) - 1
    before, here, after = (costs.gather(0, (best + step).clamp(0, last)) for step in (-1, 0, 1))
    rise_before, rise_after = before - here, after - here
    offset = (rise_before - rise_after) / (2 * (rise_before + rise_after)).clamp(min=torch.finfo(costs.dtype).tiny)
    return torch.where((best > 0) & (best < last), offset, 0.0)


LinesLoopReals = NDArray[np.float64]


@compiled
def solve_rows(
    values: LinesLoopReals,
    trust: LinesLoopReals,
    target: LinesLoopReals,
    across: LinesLoopReals,
    down: LinesLoopReals,
    solved: LinesLoopReals,
) -> None:
    """The map whose rows each minimise the energy of `relaxing` while the other rows stay.

    Args:
        values: The map so far, [H, W].
        trust: Of the targets, >= 0, [H, W].
        target: What values should be, [H, W].
        across: What ties each value to the one to its right, >= 0, the last column unused, [H, W].
        down: What ties it to the one below, the last row unused, [H, W].
        solved: Filled, [H, W].
    """
    height, width = values.shape
    share, rest = np.empty(width), np.empty(width)
    for y in range(height):
        for x in range(width):
            diagonal, side = trust[y, x], trust[y, x] * target[y, x]
            if y > 0:
                diagonal += down[y - 1, x]
                side += down[y - 1, x] * values[y - 1, x]
            if y < height - 1:
                diagonal += down[y, x]
                side += down[y, x] * values[y + 1, x]
            if x > 0:
                diagonal += across[y, x - 1] * (1 - share[x - 1])
                side += across[y, x - 1] * rest[x - 1]
            tie = across[y, x] if x < width - 1 else 0.0
            share[x], rest[x] = tie / (diagonal + tie), side / (diagonal + tie)
        solved[y, width - 1] = rest[width - 1]
        for x in range(width - 2, -1, -1):
            solved[y, x] = rest[x] + share[x] * solved[y, x + 1]


# PART relaxing
# A smooth map from values that are known unequally well: flat regions take what their edges know.
#
# The energy is the sum of trust (value - target)^2 over pixels, and of tie (value - neighbour's)^2 over neighbours.
# It is
# minimised line by line, all rows at once and then all columns.

ROUNDS = 16
"""Times that rows and columns are solved: what is known spreads farther in each."""
LEAST_TRUST = 1e-9
"""Of the ties: where neither neighbours nor pixels know anything, values stay."""


def relaxed(target: Tensor, trust: Tensor, across: Tensor, down: Tensor) -> Tensor:
    """The smooth map, float64.

    Args:
        target: What values should be, [H, W].
        trust: Of the targets, >= 0, [H, W].
        across: What ties each value to the one to its right, >= 0, the last column unused, [H, W].
        down: What ties it to the one below, the last row unused, [H, W].
    """
    aims, ties, falls = (np.ascontiguousarray(map_.double().numpy()) for map_ in (target, across, down))
    sure = trust.double().numpy() + LEAST_TRUST
    rows, columns = (sure, aims, ties, falls), tuple(np.ascontiguousarray(part.T) for part in (sure, aims, falls, ties))
    values = aims
    for _ in range(ROUNDS):
        values = _solved(values, *rows)
        values = np.ascontiguousarray(_solved(np.ascontiguousarray(values.T), *columns).T)
    return torch.from_numpy(values)


def _solved(
    values: NDArray[np.float64],
    trust: NDArray[np.float64],
    target: NDArray[np.float64],
    across: NDArray[np.float64],
    down: NDArray[np.float64],
) -> NDArray[np.float64]:
    solved = np.empty_like(values)
    solve_rows(values, trust, target, across, down, solved)
    return solved


# PART refining
# The last hundredths of a disparity: each pixel a step towards where its views agree best, then one smooth map.
#
# Views are read between their samples by splines, with the weights that `agreement` gives them. How well a pixel knows
# its disparity follows from how much its views would change with it; those that know little take their neighbours'.
# Letters: `d` disparity in pixels per view step.
# Source: Lucas, Kanade, "An Iterative Image Registration Technique", 1981.

ROUNDS_OF_REFINING = 2
FARTHEST = 0.1
"""Pixels per view step that one step may go."""
SMOOTH = 1e3
"""How well neighbours know each other, per square of pixels per view step: they differ by about 0.03."""
GAP = 0.15
"""Difference between neighbours, in pixels per view step, from which they are of different surfaces."""
CALIBRATION = 0.1
"""Of what views seem to know: their errors are alike, and not noise alone."""
WORTH_A_THREAD = 1 << 10
"""Pixels from which one more thread saves more than it costs."""


def refined(views: GreyViews, disparity: Tensor, noise: float, first: float, last: float) -> Tensor:
    """A disparity map with its fractions, float32, [H, W].

    Args:
        views: The views.
        disparity: In pixels per view step, right to about 0.1, [H, W].
        noise: Standard deviation of a view.
        first: Least disparity there may be.
        last: Largest disparity there may be.
    """
    coefficients, spread = splines.coefficients(views.samples), agreement.spread(views, noise).numpy()
    variance = noise**2 + agreement.LEAST_NOISE**2
    for _ in range(ROUNDS_OF_REFINING):
        information, steps = _steps(views, coefficients, disparity.float().numpy(), spread)
        target = disparity + steps.clamp(-FARTHEST, FARTHEST)
        ties = [SMOOTH * torch.exp(-3 * (_differences(disparity, axis) / GAP).square()) for axis in (1, 0)]
        disparity = relaxed(target, CALIBRATION / variance * information, *ties).clamp(first, last)
    return disparity.float()


def _steps(
    views: GreyViews, coefficients: np.ndarray, disparity: np.ndarray, spread: np.ndarray
) -> tuple[Tensor, Tensor]:
    information, steps = np.empty_like(disparity), np.empty_like(disparity)
    height, n_threads = len(disparity), threads.worthwhile(disparity.size, WORTH_A_THREAD)

    def find(top: int, end: int) -> None:
        band = slice(top, end)
        steps_loop.find_steps(
            coefficients, views.places, views.middle, disparity, spread, top, information[band], steps[band]
        )

    threads.share(find, threads.bands(height, n_threads), n_threads)
    return torch.from_numpy(information), torch.from_numpy(steps)


def _differences(disparity: Tensor, axis: int) -> Tensor:
    """To the next pixel along an axis; of the last one to itself."""
    return disparity.roll(-1, axis) - disparity
