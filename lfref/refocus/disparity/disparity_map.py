"""Disparity of large views by a look at half their size: a quarter of the time, enough to know where edges are.

Letters: `d` disparity in pixels per view step.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.errors import InputError
from lfref.refocus import batches, lines
from lfref.refocus.disparity import agreement, matching
from lfref.refocus.fourier import layer_energies

# PART extent
# Between which disparities to look: what the spectra of the views say, and a look at them much reduced.
#
# Spectra see what is textured, however small; the reduced views see large smooth surfaces that have next to no texture.

SMALLEST = 32
"""Pixels along the shorter side of what is looked at."""
REDUCTION = 4
"""At most."""
REACH = 4.0
"""Pixels per view step: where disparities are looked for."""
SURE = 0.3
"""Confidence from which a reduced pixel has a say."""
OUTLIERS = 0.005
"""Share of them at either end that has none."""
MARGIN = 0.15
"""Pixels per view step beyond what they say: a large part of a reduced pixel's error."""
BEYOND = 1.0
"""Pixels per view step by which they may widen what spectra say: reflections move as if they were farther off."""


def found(views: Tensor, aperture: Tensor, positions: Tensor | None = None) -> tuple[float, float]:
    """Least and largest disparity that a light field may hold, in pixels per view step.

    Args:
        views: Radiance, floating point, uint8 or uint16, [V, U, C, H, W].
        aperture: Weight of each view, their sum 1, [V, U].
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Raises:
        InputError: Views that are not finite.
    """
    # Spectra look half a step farther than views may shift.
    most = _possible(views, positions)
    first, last = layer_energies.found(views, 2, aperture).disparities[[0, -1]].clamp(-most, most).tolist()
    surfaces = _reduced(views, aperture, positions)
    if not len(surfaces):
        return first, last
    low, high = (float(surfaces[round(share * (len(surfaces) - 1))]) for share in (OUTLIERS, 1 - OUTLIERS))
    # Spectra take the grid for even: where it is not, they limit nothing.
    beyond = BEYOND if positions is None else torch.inf
    low, high = max(-most, low - MARGIN), min(most, high + MARGIN)
    return min(first, max(low, first - beyond)), max(last, min(high, last + beyond))


def _reduced(views: Tensor, aperture: Tensor, positions: Tensor | None) -> Tensor:
    """Disparities of all sure pixels of the reduced views, rising, in full pixels, [P]."""
    factor = max(1, min(REDUCTION, min(views.shape[-2:]) // SMALLEST))
    light = F.avg_pool2d(batches.radiance(views).mean(2), factor)[:, :, None]
    limit = _reach(views, positions) / factor
    slopes = matching.slopes_between(-limit, limit)
    small = agreement.grey_views(light, aperture, positions)
    noise = agreement.noise(small, slopes)
    disparity, confidence = matching.best_slopes(small, slopes, noise, 1.0)
    refined = matching.refined(small, disparity, noise, -limit, limit)
    return factor * refined[confidence > SURE].sort().values


def _reach(views: Tensor, positions: Tensor | None) -> float:
    """As far as the outermost views can shift, and no farther than `REACH`."""
    return min(REACH, _possible(views, positions))


def _possible(views: Tensor, positions: Tensor | None) -> float:
    """As far as the outermost views can shift: little less than half of them, in pixels per view step."""
    grid, size = batches.grid_and_size(views)
    shifts = geometry.corner_shift(torch.ones(1), lines.lines(grid, positions).extent)
    return 0.9 * min(size) / 2 / max(shifts, 0.5)


# PART disparity
# Disparity of what each pixel of the central view shows: the slope at which the views agree there.
#
# Views shifted by the right slope show the same point, except those from which a nearer surface hides it. Of the slopes
# tried, each pixel takes the one at which the fewest views disagree, all pixels together those that change seldom; then
# comes what lies between the slopes, and flat regions take what their edges know. The parts are in `matching`.


class DisparityMap(NamedTuple):
    """What `disparity_map` finds at each pixel of the central view."""

    disparity: Tensor
    """In pixels per view step, float32 or float64, [..., H, W]."""
    confidence: Tensor
    """How much better the views agree there than at other slopes on the whole, [0, 1), [..., H, W]."""


@torch.no_grad()
def disparity_map(
    views: Tensor,
    first: float | None = None,
    last: float | None = None,
    radius: float = 1.0,
    weights: Tensor | None = None,
    positions: Tensor | None = None,
) -> DisparityMap:
    """Find the disparity of every pixel, on the CPU.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W], more than one view.
        first: Least disparity to look for, in pixels per view step; None looks for it.
        last: Largest disparity to look for, likewise.
        radius: Standard deviation of the window in which views are compared, in pixels.
        weights: Which views to look at: those of weight 0 are not, [V, U]; None looks at all.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Returns:
        Disparity and confidence, on the device of the views. No gradients.

    Raises:
        InputError: Views, a range, a radius, weights or positions that cannot be used.

    Example:
        >>> views = torch.rand(5, 5, 3, 64, 64)
        >>> lfref.disparity_map(views, -1, 1).disparity.shape
        torch.Size([64, 64])
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    if max(grid) < 2:
        raise InputError("disparity takes more than one view", got=f"a grid of {grid[0]}x{grid[1]}")
    if not (math.isfinite(radius) and radius >= 0):
        raise InputError("radius must be finite and at least 0", got=radius, remedy="in pixels; 1 is the default")
    aperture = batches.checked_weights(weights, grid)
    found = [_found(field, aperture, positions, first, last, radius) for field in batch]
    shape, dtype = (*views.shape[:-5], *size), batches.working_dtype(views.dtype)
    return DisparityMap(
        *(torch.stack(maps).reshape(shape).to(views.device, dtype) for maps in zip(*found, strict=True))
    )


def _found(
    views: Tensor,
    aperture: Tensor,
    positions: Tensor | None,
    first: float | None,
    last: float | None,
    radius: float,
) -> tuple[Tensor, Tensor]:
    """Disparity and confidence of one light field, [H, W] each."""
    low, high = _range(views, aperture, positions, first, last)
    slopes = lines.checked_slopes(matching.slopes_between(low, high), *batches.grid_and_size(views), positions)
    light = agreement.grey_views(views, aperture, positions)
    noise = agreement.noise(light, slopes)
    disparity, confidence = matching.best_slopes(light, slopes, noise, radius)
    return matching.refined(light, disparity, noise, low, high), confidence


def _range(
    views: Tensor, aperture: Tensor, positions: Tensor | None, first: float | None, last: float | None
) -> tuple[float, float]:
    """The slopes between which to look, as asked for or as the field itself says."""
    if first is None or last is None:
        low, high = found(views, aperture, positions)
        first, last = (low if first is None else first), (high if last is None else last)
    if not (math.isfinite(first) and math.isfinite(last) and first <= last):
        raise InputError("disparities must lie between a first and a larger last one", got=f"{first} and {last}")
    return first, last


LARGE = 256
"""Pixels along the shorter side from which there is time to save, and halves of views still show where edges are."""


@torch.no_grad()
def coarse_disparity(field: Tensor, first: float | None = None, last: float | None = None) -> Tensor:
    """Disparity of each pixel of the central view; of large views alike in squares of two by two.

    Args:
        field: Radiance, [V, U, C, H, W], floating point.
        first: Least disparity to look for, in pixels per view step; None looks for it.
        last: Largest disparity to look for, likewise.

    Returns:
        In pixels per view step, [H, W].

    Raises:
        InputError: Views or a range that cannot be used.
    """
    height, width = field.shape[-2:]
    if min(height, width) < LARGE:
        return disparity_map(field, first, last).disparity
    # Colours are averaged first: the map would do so, of four times as many pixels.
    halves = F.avg_pool2d(field.mean(2), 2, ceil_mode=True, count_include_pad=False)
    low, high = (None if end is None else end / 2 for end in (first, last))
    found = 2 * disparity_map(halves[:, :, None], low, high).disparity
    return found.repeat_interleave(2, 0).repeat_interleave(2, 1)[:height, :width]
