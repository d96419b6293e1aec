"""Between which disparities to look: what the spectra of the views say, and a look at them much reduced.

Spectra see what is textured, however small; the reduced views see large smooth surfaces that have next to no texture.
"""

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.refocus import batches, lines
from lfref.refocus.fourier import layer_energies
from lfref.refocus.matching import agreement, grey, labels, refining

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
    slopes = labels.slopes_between(-limit, limit)
    small = grey.grey_views(light, aperture, positions)
    noise = agreement.noise(small, slopes)
    disparity, confidence = labels.best_slopes(small, slopes, noise, 1.0)
    refined = refining.refined(small, disparity, noise, -limit, limit)
    return factor * refined[confidence > SURE].sort().values


def _reach(views: Tensor, positions: Tensor | None) -> float:
    """As far as the outermost views can shift, and no farther than `REACH`."""
    return min(REACH, _possible(views, positions))


def _possible(views: Tensor, positions: Tensor | None) -> float:
    """As far as the outermost views can shift: little less than half of them, in pixels per view step."""
    grid, size = batches.grid_and_size(views)
    shifts = geometry.corner_shift(torch.ones(1), lines.lines(grid, positions).extent)
    return 0.9 * min(size) / 2 / max(shifts, 0.5)
