"""From the cost volume to one disparity a pixel: semi-global matching, then a refinement between the slopes tried.

The solver of `disparity_map`, apart from it because its compiled loops are a story of their own.

1. `best_slopes`. Costs C(p, n) of label n (slope s_n) at pixel p are aggregated along lines from four directions r:
   `L_r(p, n) = C(p, n) + min(L_r(q, n), L_r(q, n +- 1) + CHANGE, M_q + jump(p)) - M_q`, q = p - r the pixel before and
   M_q its least L_r.
   A change by one label, as on a slant, costs little; a jump costs more, and less where the picture has an edge. Each
   pixel takes the label whose sum over the directions is least, and the vertex of the parabola through the costs C
   there. Lines are cut into stretches that begin `BEFORE` pixels earlier: a GPU, or a file, follows all of them at
   once, in a number of steps that does not grow with the picture. Eight directions give the same pictures (57.57 for
   57.61 dB), for twice the time.
2. `refine`. A Gauss-Newton step d <- d - sum w c e / sum w c^2 for each pixel, e a view's difference from the robust
   mean, c its change with the disparity, w its agreement (`cost_volume`). The certainty of a pixel's disparity is
   sum w c^2.
3. `relax`. The map that minimises `sum trust (d - target)^2 + sum tie (d - d_neighbour)^2`: uncertain pixels
   take their neighbours' disparity, so that flat regions are filled from their edges.
Letters: `n` label, `N` labels, `p` pixel, `k` view, `y x` pixel row and column, `s` slope and `d` disparity in pixels
per view step.
Sources: Hirschmueller, "Stereo Processing by Semiglobal Matching and Mutual Information", 2008 (1); Lucas, Kanade, "An
Iterative Image Registration Technique", 1981 (2).
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from lfref.functional import loops, neighbours, splines
from lfref.functional.devices import is_known, length_within
from lfref.functional.loops import compiled, inlined
from lfref.refocus.disparity import cost_volume
from lfref.refocus.disparity.cost_volume import GreyViews, Integers, Number, Reals, mean_of, read_spline, robust_mean

RADIUS = 1.0
"""Standard deviation of the window in which views are compared, in pixels."""
STEP = 0.08
"""Largest distance of the slopes tried, in pixels per view step. With .1 or .06 the final pictures are .08 and .03 dB
worse (nine scenes of sim30)."""
CHANGE = 0.3
"""Price of a change by one label, in costs of one pixel at which all views disagree."""
JUMP = 1.5
"""Price of a jump where the picture is level, in the same unit."""
EDGE = 1.5
"""Difference to the pixel before, in mean differences of neighbours, at which a jump costs half as much."""
UNTRIED = 100.0
"""Cost of a label that is not tried: more than all others on the way of a path."""
STRETCH, BEFORE = 32, 16
"""Pixels of a line that are followed together, and pixels before them from which on they are followed."""
FARTHEST = STEP
"""Pixels per view step that one refinement may go: no farther than to the next slope tried."""
SMOOTH = 1e3
"""Tie between neighbours of one surface, per square of pixels per view step: they differ by about 0.03."""
GAP = 0.15
"""Difference of neighbours, in pixels per view step, from which they are of different surfaces."""
CALIBRATION = 0.1
"""Information that counts, as a share of the views' sum: their errors are alike, and not noise alone."""
ROUNDS = 16
"""Times that rows and columns are solved: disparities spread farther with each."""


class Labels(NamedTuple):
    """Even slopes to try; where the host does not know how many are needed, some at the end are not tried."""

    slopes: Tensor
    """Float64, [N]."""
    n_tried: Tensor
    """Number of those that are tried."""


def even_slopes(first: Tensor, last: Tensor, widest: float) -> Labels:
    """Slopes to try, at most a step apart, between ends that are at most `widest` apart."""
    count = 1 + ((last - first) / STEP - 1e-9).ceil().clamp(min=0)
    place = torch.arange(length_within(count, 1 + math.ceil(widest / STEP)), device=first.device)
    return Labels(first + (last - first) / (count - 1).clamp(min=1) * place, count)


def best_slopes(views: GreyViews, labels: Labels, noise: Tensor) -> tuple[Tensor, Tensor]:
    """The slope of each pixel, among evenly spaced ones [N], and its confidence, [H, W] each.

    `noise` is the standard deviation of the differences of views.
    """
    slopes, spread = labels.slopes, cost_volume.spread(views, noise)
    shares = neighbours.smoothed(cost_volume.disagreements(views, slopes, spread), RADIUS)
    is_tried = (torch.arange(slopes.shape[0], device=slopes.device) < labels.n_tried)[:, None, None]
    costs = aggregate(torch.where(is_tried, shares, UNTRIED), views.central)
    # The vertex of the parabola through the share there and its neighbours: path costs of neighbours are alike, and
    # their vertex is too near to the label. End labels have one neighbour, and stay.
    best, last = costs.argmin(0, keepdim=True), labels.n_tried - 1
    before, here, after = (shares.gather(0, (best + step).clamp(0, slopes.shape[0] - 1)) for step in (-1, 0, 1))
    rise_before, rise_after = before - here, after - here
    bend = (2 * (rise_before + rise_after)).clamp(min=torch.finfo(costs.dtype).tiny)
    vertex = ((rise_before - rise_after) / bend).clamp(-0.5, 0.5)
    label = best + torch.where((best > 0) & (best < last), vertex, 0.0)
    step = (slopes.gather(0, (labels.n_tried.long() - 1)[None])[0] - slopes[0]) / (labels.n_tried - 1).clamp(min=1)
    # How much better the views agree there than on the mean. The floor keeps 0 / 0 of flat views at 0.
    least, mean = shares.gather(0, best)[0], torch.where(is_tried, shares, 0.0).sum(0) / labels.n_tried
    disparity = (slopes[0] + step * label[0]).float()
    return disparity, ((mean - least) / (mean + 1e-3)).clamp(min=0)


def aggregate(costs: Tensor, picture: Tensor) -> Tensor:
    """Path costs summed over all directions, of costs [N, H, W] in [0, 1] and a picture [H, W] that shows the edges."""
    differences = [picture.diff(dim=axis).abs().flatten() for axis in (0, 1)]
    mean = torch.cat(differences).mean() if picture.numel() > 1 else picture.new_ones(())
    mean = mean.clamp(min=torch.finfo(mean.dtype).tiny)
    # Price of a jump from the pixel before: above, below, to the left and to the right. Lines begin at the border.
    jumps = [
        (JUMP / (1 + (picture - picture.roll(step, axis)).abs() / (EDGE * mean))).clamp(min=CHANGE).float()
        for axis in (0, 1)
        for step in (1, -1)
    ]
    if not is_known(costs):
        return _aggregated(costs, jumps)
    pixels_first = np.ascontiguousarray(costs.permute(1, 2, 0).numpy())
    totals = [np.zeros_like(pixels_first) for _ in range(2)]  # the order of the sum must not depend on threads

    def follow(axis: int) -> None:
        for price, is_backwards in zip(jumps[2 * axis : 2 * axis + 2], (False, True), strict=True):
            add_paths(pixels_first, price.numpy(), CHANGE, axis == 0, is_backwards, STRETCH, BEFORE, totals[axis])

    loops.share(follow, [(axis,) for axis in range(2)], torch.get_num_threads())
    return torch.from_numpy(totals[0] + totals[1]).permute(2, 0, 1).contiguous()


def _aggregated(costs: Tensor, jumps: list[Tensor]) -> Tensor:
    """As `aggregate`, by PyTorch on any device: the stretches of all lines at once, a pixel at a time."""
    directions = [
        (costs.mT, jumps[0].mT),
        (costs.mT.flip(2), jumps[1].mT.flip(1)),
        (costs, jumps[2]),
        (costs.flip(2), jumps[3].flip(1)),
    ]
    gains = torch.cat([_stretches(-lines) for lines, _ in directions], 1)  # [pixels, lines, N]
    floors = torch.cat([_stretches(-price[None]) for _, price in directions], 1)
    # Maxima of negative costs: pooling knows no minima. Of a line that has not begun, all are 0.
    path, paths = torch.zeros_like(gains[0]), []
    for gain, floor in zip(gains.unbind(0), floors.unbind(0), strict=True):
        over_best = path - path.amax(1, keepdim=True)
        changed = F.max_pool2d(over_best[None], (1, 3), 1, (0, 1))[0] - CHANGE
        path = torch.maximum(torch.maximum(over_best, changed), floor) + gain
        paths.append(path)
    followed, total = torch.stack(paths[BEFORE:]), torch.zeros((), device=costs.device)
    first = 0
    for n, (lines, _) in enumerate(directions):
        _, n_lines, length = lines.shape
        n_stretches = (length + STRETCH - 1) // STRETCH
        part = followed.narrow(1, first, n_lines * n_stretches).reshape(STRETCH, n_lines, n_stretches, -1)
        first = first + n_lines * n_stretches
        own = part.permute(3, 1, 2, 0).flatten(2).narrow(2, 0, length)
        own = own.flip(2) if n % 2 else own
        total = total - (own.mT if n < 2 else own)
    return total


def _stretches(lines: Tensor) -> Tensor:
    """Lines [N, L, pixels] cut into stretches, with pixels before them: [BEFORE + STRETCH, L * stretches, N]."""
    n_stretches = (lines.shape[2] + STRETCH - 1) // STRETCH
    padded = F.pad(lines, (BEFORE, n_stretches * STRETCH - lines.shape[2]))
    starts = STRETCH * torch.arange(n_stretches, device=lines.device)
    pixels = (starts[:, None] + torch.arange(BEFORE + STRETCH, device=lines.device)).flatten()
    return padded.index_select(2, pixels).unflatten(2, (-1, BEFORE + STRETCH)).flatten(1, 2).permute(2, 1, 0)


@compiled
def add_paths(
    costs: Reals,
    jumps: Reals,
    change: float,
    is_down: bool,
    is_backwards: bool,
    stretch: int,
    before: int,
    total: Reals,
) -> None:  # pragma: no cover - compiled
    """Add L_r of one direction to a total [H, W, N]; costs [H, W, N], jumps [H, W]."""
    height, width, n_labels = costs.shape
    n_lines, length = (width, height) if is_down else (height, width)
    path = np.zeros((2, n_labels), np.float32)
    for line in range(n_lines):
        for first in range(0, length, stretch):
            path[:] = 0  # of a line that has not begun
            for i in range(max(first - before, 0), min(first + stretch, length)):
                place = length - 1 - i if is_backwards else i
                y, x = (place, line) if is_down else (line, place)
                here = path[i % 2]
                _extend(costs[y, x], path[1 - i % 2], np.float32(change), jumps[y, x], here)
                if i >= first:
                    for n in range(n_labels):
                        total[y, x, n] += here[n]


@inlined
def _extend(costs: Reals, path: Reals, change: float, jump: float, here: Reals) -> None:
    """Path costs [N] one pixel on. Each minimum is a pass of its own, which compiles to vector instructions."""
    n_labels, least = costs.size, path.min()
    farther = least + jump
    for n in range(n_labels):
        here[n] = min(path[n], farther)
    for n in range(1, n_labels):
        here[n] = min(here[n], path[n - 1] + change)
    for n in range(n_labels - 1):
        here[n] = min(here[n], path[n + 1] + change)
    # Less the least cost before: numbers stay small, and float32 exact enough on long lines.
    for n in range(n_labels):
        here[n] += costs[n] - least


def refine(views: GreyViews, disparity: Tensor, noise: Tensor, first: float, last: float) -> Tensor:
    """A disparity map [H, W] that is right to about `STEP` with its fractions, between `first` and `last`, float32."""
    coefficients, spread = splines.coefficients(views.samples.numpy()), cost_volume.spread(views, noise).numpy()
    variance = float(noise) ** 2 + cost_volume.LEAST_NOISE**2
    for _ in range(2):
        information, steps = gauss_newton(views, coefficients, disparity.float().numpy(), spread)
        target = disparity + steps.clamp(-FARTHEST, FARTHEST)
        # Neighbours of different surfaces are not tied.
        across, down = (
            SMOOTH * torch.exp(-3 * ((disparity.roll(-1, axis) - disparity) / GAP).square()) for axis in (1, 0)
        )
        disparity = relax(target, CALIBRATION / variance * information, across, down).clamp(first, last)
    return disparity.float()


def gauss_newton(
    views: GreyViews, coefficients: np.ndarray, disparity: np.ndarray, spread: np.ndarray
) -> tuple[Tensor, Tensor]:
    """Information (sum w c^2) and step of each pixel, [H, W] each; spline coefficients of the views [K, H, W]."""
    information, steps = np.empty_like(disparity), np.empty_like(disparity)
    positions, middle = views.positions.float().numpy(), np.array(views.middle)
    n_threads = loops.worthwhile(disparity.size, 1 << 10)  # pixels from which one more thread pays

    def work(first: int, last: int) -> None:
        rows = slice(first, last)
        find_steps(coefficients, positions, middle, disparity, spread, first, information[rows], steps[rows])

    loops.share(work, loops.bands(len(disparity), n_threads), n_threads)
    return torch.from_numpy(information), torch.from_numpy(steps)


@compiled
def find_steps(
    coefficients: Reals,
    positions: Reals,
    middle: Integers,
    disparity: Reals,
    spread: Reals,
    top: int,
    information: Reals,
    steps: Reals,
) -> None:  # pragma: no cover - compiled
    """Information and steps [R, W] of a band of rows that begins at row `top`; step 0 where nothing is known."""
    n_views, height, width = coefficients.shape
    values, weights = np.empty(n_views, np.float32), np.empty(n_views, np.float32)
    gradients = np.empty((n_views, 2), np.float32)
    for i in range(steps.shape[0]):
        y = top + i
        for x in range(width):
            # What each view shows at the disparity so far; NaN beyond its borders.
            for k in range(n_views):
                v, u = positions[k]
                p, q = y + disparity[y, x] * v, x + disparity[y, x] * u
                if 0 <= p <= height - 1 and 0 <= q <= width - 1:
                    values[k], gradients[k, 0], gradients[k, 1] = read_spline(coefficients[k], p, q)
                else:
                    values[k] = np.nan
            # The robust mean: begun at the central views, then of all that agree with it, twice.
            reference = mean_of(values, middle)
            reference = robust_mean(values, reference, spread[y, x], weights)
            reference = robust_mean(values, reference, spread[y, x], weights)
            information[i, x], steps[i, x] = _step(values, gradients, positions, weights, reference)


@inlined
def _step(
    values: Reals, gradients: Reals, positions: Reals, weights: Reals, reference: Number
) -> tuple[Number, Number]:
    # Changes are taken from the mean of the gradients: noise of each view's own gradient would count as information,
    # and steps would fall short.
    total = along_y = along_x = middle_v = middle_u = np.float32(0)
    for k in range(values.size):
        if weights[k] > 0:
            total += weights[k]
            along_y += weights[k] * gradients[k, 0]
            along_x += weights[k] * gradients[k, 1]
            middle_v += weights[k] * positions[k, 0]
            middle_u += weights[k] * positions[k, 1]
    share = np.float32(1) / max(total, np.float32(1e-12))
    along_y, along_x, middle_v, middle_u = share * along_y, share * along_x, share * middle_v, share * middle_u
    # Positions count from their own mean, as the reference is a mean: it moves with the disparity too.
    information, product = np.float32(0), np.float32(0)
    for k in range(values.size):
        if weights[k] > 0:
            change = (positions[k, 0] - middle_v) * along_y + (positions[k, 1] - middle_u) * along_x
            information += weights[k] * change * change
            product -= weights[k] * change * (values[k] - reference)
    return information, product / information if information > 0 else np.float32(0)


def relax(target: Tensor, trust: Tensor, across: Tensor, down: Tensor) -> Tensor:
    """The smooth map [H, W] of step 3, float64: all rows solved at once, then all columns, again and again.

    `across` ties each value to the one to its right, `down` to the one below; the last column and row are unused.
    """
    aims, ties, falls = (np.ascontiguousarray(map_.double().numpy()) for map_ in (target, across, down))
    # Where neither neighbours nor pixels know anything, values stay.
    sure = trust.double().numpy() + 1e-9
    rows, columns = (sure, aims, ties, falls), tuple(np.ascontiguousarray(part.T) for part in (sure, aims, falls, ties))
    values, solved, turned = aims, np.empty_like(aims), np.empty_like(columns[0])
    for _ in range(ROUNDS):
        solve_rows(values, *rows, solved)
        solve_rows(np.ascontiguousarray(solved.T), *columns, turned)
        values = np.ascontiguousarray(turned.T)
    return torch.from_numpy(values)


@compiled
def solve_rows(
    values: NDArray[np.float64],
    trust: NDArray[np.float64],
    target: NDArray[np.float64],
    across: NDArray[np.float64],
    down: NDArray[np.float64],
    solved: NDArray[np.float64],
) -> None:  # pragma: no cover - compiled
    """Rows [H, W] that each minimise the energy while the other rows keep their values."""
    height, width = values.shape
    share, rest = np.empty(width), np.empty(width)
    for y in range(height):
        # A tridiagonal system, solved by Thomas' algorithm: forward, x_j = rest_j + share_j x_(j + 1).
        for x in range(width):
            diagonal, side = trust[y, x], trust[y, x] * target[y, x]
            if y > 0:
                diagonal += down[y - 1, x]
                side += down[y - 1, x] * values[y - 1, x]
            if y < height - 1:
                diagonal += down[y, x]
                side += down[y, x] * values[y + 1, x]
            if x > 0:
                # (1 - share) is computed, not the pivot less its product: no cancellation where trust is tiny.
                diagonal += across[y, x - 1] * (1 - share[x - 1])
                side += across[y, x - 1] * rest[x - 1]
            tie = across[y, x] if x < width - 1 else 0.0
            share[x], rest[x] = tie / (diagonal + tie), side / (diagonal + tie)
        # Backward.
        solved[y, width - 1] = rest[width - 1]
        for x in range(width - 2, -1, -1):
            solved[y, x] = rest[x] + share[x] * solved[y, x + 1]
