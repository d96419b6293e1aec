"""What a mixer reads of refocused planes: guides, and the candidates that it mixes. `learned_fast` is made of them.

All of it follows from sums of shifted views, box means and a few elementwise steps, so that a graph of another runtime
computes the same (`lfref.export.mixed_graph`). Layers and matching, which `learned` needs, exist only in lfref.

The picture `p` is shift-and-sum through cells. The candidates are the plain sum and the sum through binomial filters,
each twice as wide as the one before (`levels`), the central view, and the sum of views that weigh by how whole their
shifts are (`whole`): near focus such views show the pixels of the picture themselves, even aliased ones. The guides of
a plane at slope `s`, where `e` is the error scale of its picture and `d` the disparity:

    levels central whole  grey candidates minus p, in units of e, through asinh
    local                 the same of the level that is as wide as the plane is from the disparity, |s - d|
    picture               p - 1/2, grey
    spread                standard deviation over the views, in units of e
    defocus               tanh(s - d) and tanh(0.3 |s - d|)
    relief                tanh of the range of d within squares of 9 and of 33 pixels
    coverage              share of the views that do not see the pixel, doubled
    fraction              distance of s from a whole slope, at which no view is read between its pixels, doubled
    views                 log2(number of views) / 3 - 2
    error_scale noise     log10(e) / 2 + 3/2, log10(n) / 2 + 3/2

    e = hypot(mean of |local - p|, ROUGH mean of |p - binomial(p)|, n)

`n` is the noise: what is rough about the picture, but no more than the views differ by. The disparity is found by a
plane sweep over views of half the size: at each of `N_SLOPES` slopes the variance over the views, `var / (var + FLAT)`
so that no edge outvotes texture, and the mean of the slopes weighed by `exp(-cost / SHARPNESS)`. It is rougher than
that of `disparity_map` and takes a twentieth of its time; being a mean, it does not jump where two slopes are as good.
Letters: `N` planes, `K` channels of guides, `k` candidates, `C H W` channel, pixel row and column, `h w` rows and
columns of views of half the size.
"""

import functools
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from lfref import geometry
from lfref.functional import splines
from lfref.functional.neighbours import binomial, box_max, box_mean
from lfref.geometry import Slopes
from lfref.lightfield import LightField
from lfref.refocus import batches
from lfref.refocus.focus.slope_range import DisparityRange
from lfref.refocus.sampling import Interpolation
from lfref.refocus.shift import shift_plan
from lfref.refocus.shift.shift_and_sum import cell_widths, disparity_range, planned_stack, shift_and_sum
from lfref.refocuser import filling
from lfref.refocuser.features import RELIEF_WINDOWS, ROUGHNESS, WINDOW, RefinerInputs
from lfref.refocuser.refocuser import Aperture, Operator, OperatorRefocuser

APART = (1, 2, 4, 8)
"""Distances of the neighbours in the binomial filters that make a level of the one before."""
N_LEVELS = len(APART) + 1
VARIANCES = tuple((4**level - 1) / 6 for level in range(N_LEVELS))
"""Variance of the filter of each level along an axis, in square pixels."""
N_CANDIDATES = N_LEVELS + 2
"""Levels, the central view, and the sum by whole shifts."""
N_GUIDES = N_CANDIDATES + 12
"""Channels of guides."""

# The values below are those that the shipped mixer was trained with, but for FLAT, FAINT and BLACK.
# With a third, a tenth and a twentieth of these, as in the training, rounding of float32 decided in flat regions;
# pictures are as near to the truth.
BLACK = 2e-5
"""Light added to error scale and noise before one divides by them or takes their logarithm."""
SPLINE = Interpolation(splines.basis, before=1)
"""Reads coefficients of splines."""
WHOLE, LEAST_WEIGHT = 0.15, 1e-3
"""Standard deviation of a shift from a whole pixel, by which a view weighs in the sum by whole shifts; least weight."""
ROUGH = 0.1
"""Share of its roughness that a picture is wrong by, at least: interpolation smooths what is rough."""
N_SLOPES = 33
"""Slopes of the sweep."""
FLAT = 3e-5
"""Variance over the views at which half of the disagreement is reached, in square light."""
SHARPNESS = 0.02
"""Difference of disagreements, of at most 1, that counts e times as much."""
FAINT = 1e-5
"""Variance over the views, in square light, that is added to all: below it, rounding of float32 would decide."""
LEAST_REACH = 1.25
"""Pixels per view step on either side of 0 that are swept in any case: gradients overlook smooth surfaces."""
SPARE = 0.25
"""Pixels per view step, and share of its width, that the range of the gradients is widened by on either side."""


class PlaneParts(NamedTuple):
    """What guides and candidates are computed from."""

    pictures: Tensor
    """Shift-and-sum through cells, [N, C, H, W]."""
    sums: Tensor
    """Plain sums, [N, C, H, W]."""
    squares: Tensor
    """Plain sums of the squared grey views, [N, 1, H, W]."""
    central: Tensor
    """View at the angular centre, [C, H, W]."""
    disparity: Tensor
    """Of each pixel of the central view, in pixels per view step, [H, W]."""
    whole: Tensor
    """Sums by whole shifts, [N, C, H, W]."""
    slopes: Tensor
    """In pixels per view step, [N]."""
    covered: Tensor
    """Share of the views that see a pixel, [N, 1, H, W]."""


def mixer_inputs(
    light: LightField,
    slopes: Tensor,
    aperture: Aperture | None = None,
    n_at_once: int | None = None,
    dtype: torch.dtype = torch.float32,
) -> Iterator[RefinerInputs]:
    """Refocus a light field, and compute what a mixer reads of the planes.

    Args:
        light: Floating point.
        slopes: In pixels per view step, float64, [N].
        aperture: Weights of the views of any grid; None weighs all alike.
        n_at_once: Planes in each part; None: all.
        dtype: Of the guides.

    Yields:
        Consecutive planes, `n_at_once` in each part but the last. Their features are differences, in light, and guides.
    """
    views, weight = light.views, light.weight
    whole = views if weight is None else filling.filled(views, weight.to(views))

    def refocused(images: Tensor, operator: Operator, planes: Tensor = slopes) -> Tensor:
        return OperatorRefocuser("a part", operator, aperture).stack(images, weight, planes, light.positions)

    disparities = disparity_range(whole)
    widths = cell_widths(slopes.cpu(), disparities).clamp(max=min(light.size))
    # The coefficients of the views serve all planes; samples with weights are multiplied by them first.
    images = torch.cat([views, views.mean(2, keepdim=True).square()], 2)
    images, operator = (spline_coefficients(images), sum_of_coefficients) if weight is None else (images, spline_sum)
    sums, squares = refocused(images, operator).split([views.shape[2], 1], 1)
    colours, pictures = images[:, :, : views.shape[2]], sums
    whole_sums = refocused(colours, functools.partial(sum_by_whole_shifts, operator))
    if len(blurred := widths.nonzero()[:, 0]):
        through_cells = functools.partial(operator, widths=widths[blurred].tolist())
        planes = refocused(colours, through_cells, slopes[blurred])
        pictures = sums.index_copy(0, blurred.to(sums.device), planes)
    del images, colours
    parts = PlaneParts(
        pictures,
        sums,
        squares,
        central_view(whole),
        swept_disparity(whole, disparities),
        whole_sums,
        slopes.to(views),
        coverage(slopes.to(views), light.grid, light.size),
    )
    weights = views.new_ones(light.grid) if aperture is None else aperture(light.grid).to(views)
    n_views = float(weights.sum().square() / weights.square().sum())  # equal views that average noise as much
    n_at_once = n_at_once or len(slopes)
    for first in range(0, len(slopes), n_at_once):
        at = slice(first, first + n_at_once)
        some = parts._replace(
            **{name: getattr(parts, name)[at] for name in ("pictures", "sums", "squares", "whole", "slopes", "covered")}
        )
        guides, differences, error_scale = guides_and_differences(some, n_views)
        yield RefinerInputs(torch.cat([differences, guides], 1).to(dtype), some.pictures, error_scale)


def spline_sum(
    views: Tensor,
    slopes: Slopes,
    weights: Tensor | None = None,
    positions: Tensor | None = None,
    widths: Sequence[float] | None = None,
) -> Tensor:
    """Shift-and-sum by cubic splines, which keep more detail between samples than cubic convolution does.

    Args:
        views: [..., V, U, C, H, W].
        slopes: In pixels per view step, [N].
        weights: Weight of each view, [V, U]; None weighs all alike.
        positions: Of the cameras, as in `shift_and_sum`.
        widths: Of the box that blurs each plane, in pixels, [N]; None: no blur.
    """
    return sum_of_coefficients(spline_coefficients(views), slopes, weights, positions, widths)


def spline_coefficients(views: Tensor) -> Tensor:
    """Coefficients of the splines through views [..., H, W]."""
    images = batches.radiance(views)
    coefficients = splines.coefficients(images.cpu().reshape(-1, *images.shape[-2:]).numpy())
    return torch.from_numpy(coefficients).reshape(images.shape).to(images)


def sum_of_coefficients(
    coefficients: Tensor,
    slopes: Slopes,
    weights: Tensor | None = None,
    positions: Tensor | None = None,
    widths: Sequence[float] | None = None,
) -> Tensor:
    """As `spline_sum`, for the `spline_coefficients` of the views."""
    batch = batches.flattened(coefficients)
    grid, size = batches.grid_and_size(batch)
    planes = batches.checked_slopes(slopes, grid, size, positions)
    plan = shift_plan.plan(planes, grid, size, "cubic", weights=weights, widths=widths, positions=positions)
    return batches.restored(planned_stack(batch, plan._replace(interpolation=SPLINE)), coefficients)


def sum_by_whole_shifts(
    operator: Operator, images: Tensor, slopes: Tensor, weights: Tensor | None = None, positions: Tensor | None = None
) -> Tensor:
    """Sums of views that weigh by how near their shifts are to whole pixels.

    Args:
        operator: `sum_of_coefficients` or `spline_sum`.
        images: What it sums.
        slopes: In pixels per view step, [N].
        weights: Further weight of each view, [V, U]; None weighs all alike.
        positions: Of the cameras.
    """
    rows, columns = whole_weights(torch.as_tensor(slopes), images.shape[-5:-3])
    sums = []
    for slope, row, column in zip(slopes, rows, columns, strict=True):
        own = row[:, None] * column
        own = own if weights is None else own * weights.to(own)
        sums.append(operator(images, slope[None], weights=own, positions=positions))
    return torch.cat(sums, -4)


def whole_weights(slopes: Tensor, grid: Sequence[int]) -> tuple[Tensor, Tensor]:
    """Weight of each view row and of each view column in planes [N] of the sum by whole shifts, [N, V] and [N, U]."""
    shifts = [slopes[:, None] * geometry.angular_offsets(n_views).to(slopes) for n_views in grid]
    weights = [((shift - shift.round()) / WHOLE).square().mul(-0.5).exp().clamp(min=LEAST_WEIGHT) for shift in shifts]
    return weights[0], weights[1]


def guides_and_differences(parts: PlaneParts, n_views: float) -> tuple[Tensor, Tensor, Tensor]:
    """Guides [N, K, H, W], candidates minus pictures [N, k C, H, W], and error scales [N, 1, H, W], 0 where a view is
    missing; by operations that graphs of other runtimes know.

    Args:
        parts: Of some planes.
        n_views: Number of equal views that average noise as much as these.
    """
    pictures, disparity = parts.pictures, parts.disparity[None, None]
    levels = [parts.sums]
    for apart in APART:
        levels.append(binomial(levels[-1], apart))
    candidates = [*levels, parts.central.expand(pictures.shape), parts.whole]
    grey, *greys = (images.mean(1, keepdim=True) for images in (pictures, *candidates))
    slopes = parts.slopes[:, None, None, None]
    defocus = slopes - disparity

    # The level of each pixel's own blur: the box of a cell, |s - d| pixels wide, has the variance (s - d)^2 / 12.
    place, local = defocus.square() / 12, torch.zeros_like(grey)
    for level, images in enumerate(greys[:N_LEVELS]):
        rise, fall = torch.ones_like(place), torch.ones_like(place)
        if level > 0:
            rise = (place - VARIANCES[level - 1]) / (VARIANCES[level] - VARIANCES[level - 1])
        if level < N_LEVELS - 1:
            fall = (VARIANCES[level + 1] - place) / (VARIANCES[level + 1] - VARIANCES[level])
        local = local + torch.minimum(rise, fall).clamp(0, 1) * images

    spread = (parts.squares - greys[0].square()).clamp(min=0).add(FAINT).sqrt()
    rough = box_mean((grey - binomial(grey)).abs(), WINDOW)
    # Grey views differ less: noise of its own in each of C channels is sqrt(C) times as large.
    deviation = math.sqrt(pictures.shape[1] / n_views) * box_mean(spread, WINDOW)
    noise = (ROUGHNESS * rough).minimum(deviation)
    apart_from_local = box_mean((local - grey).abs(), WINDOW)
    error_scale = (apart_from_local.square() + (ROUGH * rough).square() + noise.square()).sqrt()
    unit = error_scale + BLACK

    ranges = [(-box_max(-disparity, window), box_max(disparity, window)) for window in RELIEF_WINDOWS]
    relief = torch.cat([high - low for low, high in ranges], 1).tanh()
    fraction = 2 * (slopes - slopes.round()).abs()
    one = torch.ones_like(grey)
    guides = [
        *(squashed(other - grey, unit) for other in (*greys, local)),
        grey - 0.5,
        squashed(spread, unit),
        defocus.tanh(),
        (0.3 * defocus.abs()).tanh(),
        relief.expand(pictures.shape[0], -1, -1, -1),
        2 * (1 - parts.covered),
        fraction * one,
        (math.log2(max(n_views, 1.0)) / 3 - 2) * one,
        unit.log10() / 2 + 1.5,
        (noise + BLACK).log10() / 2 + 1.5,
    ]
    seen = (parts.covered > 0.999).to(pictures)
    return torch.cat(guides, 1), torch.cat([other - pictures for other in candidates], 1), seen * error_scale


def squashed(difference: Tensor, unit: Tensor) -> Tensor:
    """asinh(|difference| / unit) / 3 with the sign of the difference: small errors and copies of edges in one range."""
    ratio = difference.abs() / unit
    return (ratio + (ratio.square() + 1).sqrt()).log() / 3 * difference.sign()


def central_view(views: Tensor) -> Tensor:
    """The view at the angular centre, of even grids the mean of the middle ones, [C, H, W], for [V, U, C, H, W]."""
    rows, columns = (slice((n_views - 1) // 2, n_views // 2 + 1) for n_views in views.shape[:2])
    return views[rows, columns].mean((0, 1))


def coverage(slopes: Tensor, grid: tuple[int, int], size: tuple[int, int]) -> Tensor:
    """Share of the views that have a sample at a pixel of a plane, [N, 1, H, W], for slopes [N]."""
    shares = []
    for n_views, n_pixels in zip(grid, size, strict=True):
        offsets = geometry.angular_offsets(n_views).to(slopes)
        at = torch.arange(n_pixels, device=slopes.device) + (slopes[:, None] * offsets)[..., None]
        # Rounding must not decide where a position falls on the outermost pixel.
        shares.append(((at > -1e-3) & (at + 0.999 < n_pixels)).to(slopes).mean(1))
    rows, columns = shares
    return rows[:, None, :, None] * columns[:, None, None, :]


def swept_disparity(views: Tensor, disparities: DisparityRange) -> Tensor:
    """Disparity of each pixel of the central view by a plane sweep, in pixels per view step, [H, W].

    Args:
        views: [V, U, C, H, W].
        disparities: What gradients say about the range.
    """
    height, width = views.shape[-2:]
    halves = centred(half_size(views.mean(2, keepdim=True)))
    low, high, shorter = torch.tensor([disparities.low, disparities.high, min(height, width)]).double()
    first, last = sweep_ends(low, high, views.shape[:2], shorter)
    slopes = torch.linspace(float(first), float(last), N_SLOPES, dtype=torch.float64)
    moments = shift_and_sum(torch.cat([halves, halves.square()], 2), slopes / 2, "cubic")
    return full_size(best_slopes(moments, slopes.to(views)), height, width)


def sweep_ends(low: Tensor, high: Tensor, grid: tuple[int, ...], shorter: Tensor) -> tuple[Tensor, Tensor]:
    """First and last slope of a sweep, in pixels per view step.

    Args:
        low: Least disparity by gradients.
        high: Largest disparity by gradients.
        grid: View rows and columns.
        shorter: Pixels along the shorter side.
    """
    farthest = shorter * (0.45 / max((max(grid) - 1) / 2, 0.5))
    spare = SPARE * (1 + high - low)
    first = torch.maximum((low - spare).clamp(max=-LEAST_REACH), -farthest)
    return first, torch.minimum((high + spare).clamp(min=LEAST_REACH), farthest)


def half_size(images: Tensor) -> Tensor:
    """Means of squares of two by two pixels, [..., h, w]; the last row and column count twice where their number is
    odd."""
    for axis in (-2, -1):
        length = images.shape[axis]
        pairs = torch.arange(0, length, 2, device=images.device)
        after = (pairs + 1).clamp(max=length - 1)
        images = (images.index_select(axis, pairs) + images.index_select(axis, after)) / 2
    return images


def centred(images: Tensor) -> Tensor:
    """Images [V, U, C, h, w] without their common mean: the variance is the same, and squares lose fewer digits."""
    return images - images.mean((-2, -1), keepdim=True).mean((0, 1, 2), keepdim=True)


def full_size(images: Tensor, height: int, width: int) -> Tensor:
    """Every pixel of images [h, w] in squares of two by two, [H, W]."""
    rows, columns = (torch.arange(length, device=images.device) // 2 for length in (height, width))
    return images.index_select(0, rows).index_select(1, columns)


def best_slopes(moments: Tensor, slopes: Tensor) -> Tensor:
    """The slope at which views agree best, [h, w].

    Args:
        moments: Mean over the views and mean of their squares at each slope, [S, 2, h, w].
        slopes: [S].
    """
    mean, square = moments[:, :1], moments[:, 1:]
    variance = (square - mean.square()).clamp(min=0)
    costs = binomial(box_mean(variance / (variance + FLAT), WINDOW))[:, 0]
    return ((-costs / SHARPNESS).softmax(0) * slopes[:, None, None]).sum(0)
