"""Disparity of what each pixel of the central view shows, and which sign of it is nearer.

`disparity_map`: the range of disparities (`estimate_range`), the cost volume over slopes within it (`cost_volume`),
semi-global matching and refinement between the slopes (`matching`). `coarse_disparity` does the same at half the size:
a quarter of the time, enough to know where edges are. Methods refocus by it. Around small lights it holds the disparity
of the light.
`order_score`: what hides is in front of what is hidden. Cameras counted in our order see near points move against
their own way, d falls with nearness; where both axes of the views are reversed it rises. Next to the edge of a surface
in front, half of the views of a line see what the other half does not: that half agrees at the disparity of what is
behind. Whether the disparities around are larger or smaller than that one is counted over the picture.
Letters: `s` slope and `d` disparity in pixels per view step, `N` slopes tried, `n` views of a line.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.errors import InputError
from lfref.functional import devices, neighbours
from lfref.functional.devices import may_hold, number
from lfref.refocus import batches
from lfref.refocus.disparity import cost_volume, matching
from lfref.refocus.disparity.matching import Labels
from lfref.refocus.focus.line_range import wide_range
from lfref.refocus.focus.slope_range import DisparityRange
from lfref.refocus.fourier import energies
from lfref.refocus.shift.shift_and_sum import shift_and_sum, sums_of

SURE = 0.3
"""Confidence from which a reduced pixel counts for the range."""
OUTLIERS = 0.005
"""Share of these pixels beyond either end of the range."""
MARGIN = 0.15
"""Pixels per view step added at either end: a large part of a reduced pixel's error."""
BEYOND = 1.0
"""Pixels per view step by which reduced views may widen the range of the spectra: reflections seem farther off."""
LARGE = 256
"""Pixels along the shorter side from which views of half the size still show where edges are."""
LIGHT, SURROUNDINGS = 4.0, 65
"""How many times a pixel of a light is as bright as the mean of the square around it, and the side of that square in
pixels: a large bright surface is no light."""
AROUND_LIGHTS, SHARP = 9, 7
"""Sides of squares in pixels: how far around a light its edge is read, and in which the differences of views are
averaged; by trial on random scenes with lights."""


class DisparityMap(NamedTuple):
    """Result of `disparity_map` at each pixel of the central view."""

    disparity: Tensor
    """In pixels per view step, float32 or float64, [..., H, W]."""
    confidence: Tensor
    """How much better the views agree there than at other slopes on the mean, [0, 1), [..., H, W]."""


@torch.no_grad()
def disparity_map(
    views: Tensor,
    first: float | None = None,
    last: float | None = None,
    weights: Tensor | None = None,
    positions: Tensor | None = None,
) -> DisparityMap:
    """Find the disparity of every pixel, on the CPU.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W], more than one view.
        first: Least disparity to look for, in pixels per view step; None estimates it.
        last: Largest disparity to look for, in pixels per view step; None estimates it.
        weights: Weight of each view, those of 0 are not read, [V, U]; None reads all.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Returns:
        Disparity and confidence, on the device of the views. No gradients.

    Raises:
        InputError: Views, a range, weights or positions that cannot be used.

    Example:
        >>> views = torch.rand(5, 5, 3, 64, 64)
        >>> lfref.disparity_map(views, -1, 1).disparity.shape
        torch.Size([64, 64])
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    aperture = batches.checked_weights(weights, grid)
    maps = []
    for field in batch:
        grey = cost_volume.grey_of(field, aperture)
        views_read = cost_volume.grey_views(grey, aperture, positions)
        low, high = first, last
        if low is None or high is None:
            known = wide_range(field.detach(), aperture, positions)
            held = energies.energy_range(grey, aperture, known)
            estimated = estimate_range(grey, aperture, energies.farthest(known), held, positions)
            low, high = (float(end) if own is None else own for own, end in zip((low, high), estimated, strict=True))
        if not (math.isfinite(low) and math.isfinite(high) and low <= high):
            raise InputError("disparities must lie between a first and a larger last one", got=f"{low} and {high}")
        labels = matching.even_slopes(number(low, grey), number(high, grey), high - low)
        batches.checked_slopes(labels.slopes, grid, size, positions)
        light = cost_volume.details(views_read, labels.slopes)
        noise = cost_volume.noise(light, labels.slopes)
        disparity, confidence = matching.best_slopes(light, labels, noise)
        maps.append((matching.refine(light, disparity, noise, low, high), confidence))
    shape, dtype = (*views.shape[:-5], *size), batches.working_dtype(views.dtype)
    return DisparityMap(*(torch.stack(part).reshape(shape).to(views.device, dtype) for part in zip(*maps, strict=True)))


@torch.no_grad()
def coarse_disparity(grey: Tensor, known: DisparityRange | None, held: tuple[Tensor, Tensor]) -> Tensor:
    """Disparity of the central view of grey views [V, U, H, W], around lights that of the light, [H, W].

    `known` is the range of their disparities, if it is wide, and `held` the ends of those that spectra hold.
    """
    height, width = grey.shape[-2:]
    scale, reduced = 1, grey
    if min(height, width) >= LARGE:
        scale, reduced = 2, F.avg_pool2d(grey, 2, ceil_mode=True, count_include_pad=False)
    first, last = (end / scale for end in energies.farthest(known))
    aperture = batches.checked_weights(None, (grey.shape[0], grey.shape[1]))
    low, high = estimate_range(reduced, aperture, (first, last), (held[0] / scale, held[1] / scale))
    labels = matching.even_slopes(low, high, last - first + energies.STEP / scale + 2 * BEYOND)
    views = cost_volume.details(cost_volume.grey_views(reduced, aperture), labels.slopes)
    disparity, _ = matching.best_slopes(views, labels, cost_volume.noise(views, labels.slopes))
    disparity = scale * _with_lights(reduced, disparity, labels)
    return disparity.repeat_interleave(scale, 0).repeat_interleave(scale, 1).narrow(0, 0, height).narrow(1, 0, width)


def _with_lights(grey: Tensor, disparity: Tensor, labels: Labels) -> Tensor:
    """A disparity map [H, W], with the slope of least variance of the views around lights.

    In matching, each view has one vote: the edge of a light counts no more than weak texture. But most of the light
    that is refocused there comes from it, and the variance is least at the slope at which it is sharp.
    """
    rows, columns = (slice((n_views - 1) // 2, n_views // 2 + 1) for n_views in grey.shape[:2])
    middle = grey[rows, columns].mean((0, 1))
    is_light = middle > LIGHT * neighbours.box_mean(middle[None], SURROUNDINGS)[0]
    is_light = neighbours.box_max(is_light.to(grey)[None], AROUND_LIGHTS)[0] > 0
    if not may_hold(is_light.any()):
        return disparity
    mean, square = sums_of(torch.stack([grey, grey.square()], 2), labels.slopes).unbind(1)
    variance = neighbours.box_mean((square - mean.square()).clamp(min=0), SHARP)
    is_tried = torch.arange(variance.shape[0], device=grey.device) < labels.n_tried
    best = torch.where(is_tried[:, None, None], variance, torch.inf).argmin(0)
    sharpest = labels.slopes.to(disparity)[best]
    # A minimum at an end of the search is no estimate; and the map is finer than the slopes that are tried.
    is_inside = (best > 0) & (best < labels.n_tried - 1)
    is_other = (sharpest - disparity).abs() > 1.5 * matching.STEP
    return torch.where(is_light & is_inside & is_other, sharpest, disparity)


def estimate_range(
    grey: Tensor,
    aperture: Tensor,
    tried: tuple[float, float],
    held: tuple[Tensor, Tensor],
    positions: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Least and largest disparity that grey views [V, U, H, W] may hold, in pixels per view step.

    The range is that of the spectra, `held`, which know all texture, widened by that of matched reduced views, which
    know large smooth surfaces between the ends that are `tried`.
    """
    # The outermost views can shift by a little less than half of their size.
    grid, size = (grey.shape[0], grey.shape[1]), grey.shape[2:]
    shift = (max(batches.lines(grid, positions).extent) - 1) / 2
    most = 0.9 / 2 / max(shift, 0.5) * torch.minimum(*(number(length, grey) for length in size))
    first, last = (end.clamp(-most, most) for end in held)
    # Views of at least 32 pixels, at most 4 times smaller.
    factor = min(max(1, min(4, length // 32)) for length in size)
    low, high = (number(end, grey).clamp(-most, most) / factor for end in tried)
    labels = matching.even_slopes(low, high, (tried[1] - tried[0]) / factor)
    small = cost_volume.grey_views(F.avg_pool2d(grey, factor), aperture, positions)
    disparity, confidence = matching.best_slopes(small, labels, cost_volume.noise(small, labels.slopes))
    is_sure = confidence > SURE
    surfaces = torch.where(is_sure, factor * disparity.double(), devices.BEYOND).flatten().sort().values
    n_sure = is_sure.sum()
    least, greatest = (
        surfaces.gather(0, (share * (n_sure - 1)).round().long().clamp(min=0)[None])[0]
        for share in (OUTLIERS, 1 - OUTLIERS)
    )
    # Spectra take the grid for even: where it is not, they limit nothing.
    beyond = BEYOND if positions is None else torch.inf
    below, above = (least - MARGIN).clamp(min=-most), (greatest + MARGIN).clamp(max=most)
    wider = (
        torch.minimum(first, torch.maximum(below, first - beyond)),
        torch.maximum(last, torch.minimum(above, last + beyond)),
    )
    return torch.where(n_sure > 0, wider[0], first), torch.where(n_sure > 0, wider[1], last)


RIM = 8
"""Pixels at the borders that `order_score` leaves out: views end there."""
FEWEST = 30
"""Pixels that must be sure, and that must be hidden from half of the views, for a statement about the order."""
SIDES_STEP = 0.1
"""Distance of the slopes at which both halves of a line are compared, in pixels per view step."""
UNLIKE = 6.0
"""Variance of the half that a surface hides the pixel from, in variances of the half that sees it, at least."""
LEAST_HIDDEN = 0.015
"""Share of the picture's variance that this variance has at least, by trial on sim30: without it, twigs before a smooth
sky would be behind it."""
FAINTEST = 1e-4
"""Variance over all slopes below which a pixel has no texture to compare."""
NOTABLE, OWN = 0.35, 0.1
"""Shares of the range of disparities: least step to the surface in front; largest step within one surface."""


CLEAR = 0.5
"""Least absolute `order_score` of a statement about the order."""


@torch.no_grad()
def order_score(views: Tensor, disparity: Tensor, confidence: Tensor) -> float:
    """How clearly larger disparities (up to 1) or smaller ones (down to -1) are nearer; 0 where nothing hides anything.

    It takes a light field [V, U, C, H, W], of which the middle row and column of views are read, the disparity of the
    central view and its confidence, [H, W] each.
    """
    sure = disparity[confidence > 0.4]
    if sure.numel() < FEWEST:
        return 0.0
    ordered = sure.double().sort().values
    first, last = (float(ordered[round(share * (len(ordered) - 1))]) for share in (0.01, 0.99))
    light = batches.radiance(views).mean(2, keepdim=True)
    middle_row, middle_column = light[None, light.shape[0] // 2], light[:, None, light.shape[1] // 2]
    ends = first - SIDES_STEP, last + SIDES_STEP
    steps = torch.cat([_steps_to_front(line, disparity, *ends) for line in (middle_row, middle_column)])
    return float(steps.sum() / steps.abs().sum()) if len(steps) >= FEWEST else 0.0


def _steps_to_front(line: Tensor, disparity: Tensor, first: float, last: float) -> Tensor:
    """Disparity around minus that of each pixel that one half of a line [1, n, 1, H, W] does not see, [P], weighted by
    the standard deviation of the views of that half."""
    n_views = max(line.shape[:2])
    if n_views < 3 or min(line.shape[-2:]) <= 2 * RIM:
        return line.new_zeros(0)
    slopes = torch.linspace(first, last, 1 + math.ceil((last - first) / SIDES_STEP), dtype=torch.float64)
    offsets, moments, costs = torch.arange(n_views) - (n_views - 1) / 2, torch.cat([line, line.square()], 2), []
    for side in (1, -1):
        # Variance of the views on one side of the centre at each slope: mean of squares less square of the mean.
        weights = (side * offsets >= 0).double().reshape(line.shape[:2])
        mean, square = shift_and_sum(moments, slopes, "cubic", weights=weights).unbind(1)
        costs.append(neighbours.smoothed((square - mean.square()).clamp(min=0), 1.0) + 1e-6)  # 8 bits resolve no less
    (least, best), (other_least, other_best) = (cost.min(0, keepdim=True) for cost in costs)
    # The half that agrees better sees the pixel; the other one is tested at the same slope.
    is_one = least < other_least
    hidden = torch.where(is_one, costs[1].gather(0, best), costs[0].gather(0, other_best))[0]
    visible = torch.where(is_one, least, other_least)[0]
    mean = torch.where(is_one[0], costs[0].mean(0), costs[1].mean(0))
    # How far disparities within 3 pixels reach above and below the one of the visible half.
    around, here = disparity.to(line), slopes.to(line)[torch.where(is_one, best, other_best)[0]]
    rise, fall = neighbours.box_max(around, 7) - here, here + neighbours.box_max(-around, 7)
    step = rise.clamp(min=0) - fall.clamp(min=0)
    is_hidden = (hidden > UNLIKE * visible) & (visible < 0.2 * mean) & (mean > FAINTEST)
    is_hidden &= step.abs() > NOTABLE * (last - first)
    is_hidden &= torch.minimum(rise.abs(), fall.abs()) < max(SIDES_STEP, OWN * (last - first))
    inside = slice(RIM, -RIM)
    # What hides a pixel changes it much; where the halves hardly differ, a smooth surface was read at a wrong slope.
    is_hidden &= hidden > LEAST_HIDDEN * line.var()
    return (step * hidden.sqrt())[inside, inside][is_hidden[inside, inside]]
