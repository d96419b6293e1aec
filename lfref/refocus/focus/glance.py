"""Disparity in a tenth of a second: least squares on a few small views, after shifts by whole pixels.

For each of many slopes the views are shifted by the nearest whole pixels; what is left of their differences is then a
small displacement, which the gradient of their mean explains. Of all slopes that one counts which leaves the least
unexplained. The sweep makes hold for many pixels what least squares do within one; the least squares make a few slopes
do, and tell how sure each pixel is.
Letters: `h w` rows and columns of reduced pixels.
Source: Adelson, Wang, "Single Lens Stereo with a Plenoptic Camera", 1992; the sweep over shifts is ours.
"""

import functools
import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.refocus.focus import reduced_views, slope_fit
from lfref.refocus.focus.reduced_views import ReducedViews
from lfref.refocus.focus.slope_fit import Fit

COARSE_SIDE, COARSEST = 24, 4  # reduced pixels along the shorter side of the first look; factor at most
WIDEST = 4.0  # coarse pixels per view step: the first look reaches so far
MARGIN = 0.5  # reduced pixels per view step that the second look goes beyond the first
FLOOR = 1e-7  # variance of square roots of light: 8 bits round to about ten times that
MOST_SLOPES = 48  # tried in one look: what spans more than that is noise
AT_ONCE = 40_000  # pixels: small views are tried at many slopes at once
UNKNOWN = 0.02  # confidence below which a pixel gets the median disparity of the others
UNSURE = 0.03  # standard error in reduced pixels per view step from which on a disparity is worth less than half


class Glance(NamedTuple):
    """What is seen in a first look at a light field."""

    disparity: Tensor
    """Of what the reference view shows, in pixels per view step, float32, [h, w]."""
    confidence: Tensor
    """1 / (1 + (standard error / .03 reduced pixels per view step)²), in [0, 1], float32, [h, w]."""
    factor: int
    """Pixels along each side of a reduced pixel."""


@torch.no_grad()
def glance(seen: ReducedViews) -> Glance:
    """Find disparities.

    Args:
        seen: Reduced views.

    Returns:
        Disparity and confidence. A pixel of which nothing is known has the median disparity of the others and the
        confidence 0; all are 0 where nothing moves, nothing is to be seen, or there is one view only.

    Example:
        >>> from lfref.refocus.focus.reduced_views import reduced
        >>> glance(reduced(torch.rand(5, 5, 3, 64, 64))).disparity.shape
        torch.Size([64, 64])
    """
    coarse = first_look(seen)
    if not bool(coarse.confidence.any()):
        empty = torch.zeros(seen.pictures.shape[1:])
        return Glance(empty, empty, seen.factor)
    sure = coarse.confidence >= min(0.5, float(coarse.confidence.quantile(0.8)))
    ends = coarse.disparity[sure].quantile(torch.tensor([0.005, 0.995])) / seen.factor
    return _looked(seen, float(ends[0]) - MARGIN, float(ends[1]) + MARGIN)


@torch.no_grad()
def first_look(seen: ReducedViews) -> Glance:
    """The same as `glance`, from views that are reduced once more: for what must be known in the large only.

    Args:
        seen: Reduced views.
    """
    size = seen.pictures.shape[1:]
    if len(seen.places) < 2 or min(size) < 2:
        empty = torch.zeros(size)
        return Glance(empty, empty, seen.factor)
    widest = WIDEST * min(1.0, reduced_views.REACH / seen.reach) if seen.reach else WIDEST
    return _looked(seen.smaller(max(1, min(COARSEST, min(size) // COARSE_SIDE))), -widest, widest)


def _looked(seen: ReducedViews, low: float, high: float) -> Glance:
    """Disparities between two slopes, in reduced pixels per view step."""
    step = 1 / max(seen.reach, 2.0)
    slopes = _slopes(low, high, step)
    fit = _swept(seen, slopes, max(step, slopes[1] - slopes[0]))
    confidence = _confidence(fit)
    known = confidence >= UNKNOWN
    middle = fit.disparity[known].median() if bool(known.any()) else 0.0
    return Glance(seen.factor * torch.where(known, fit.disparity, middle), confidence, seen.factor)


def _slopes(low: float, high: float, step: float) -> list[float]:
    n = min(MOST_SLOPES, max(2, 1 + math.ceil((high - low) / step - 1e-9)))
    return torch.linspace(low, high, n, dtype=torch.float64).tolist()


def _confidence(fit: Fit) -> Tensor:
    window = (2 * slope_fit.WINDOW + 1) ** 2
    error = (fit.unexplained + FLOOR) / (fit.information * window).clamp(min=1e-12)
    return torch.where(fit.freedom > 0, 1 / (1 + error / UNSURE**2), 0.0)


def _swept(seen: ReducedViews, slopes: list[float], step: float) -> Fit:
    """The fit of that slope which leaves the least unexplained, at each pixel."""
    pad = math.ceil(max(abs(slopes[0]), abs(slopes[-1])) * seen.reach) + 1
    weights = F.pad(seen.weights, (pad,) * 4)
    light = F.pad(_softened(seen.pictures), (pad,) * 4) * weights
    parts = torch.tensor(slopes, dtype=torch.float64).split(max(1, AT_ONCE // light[0].numel()))
    fits = [fit for part in parts for fit in slope_fit.fits(light, weights, seen.steps, part, step, pad)]
    return functools.reduce(_better, fits)


def _better(one: Fit, other: Fit) -> Fit:
    is_worse = other.unexplained < one.unexplained
    return Fit(*(torch.where(is_worse, new, old) for new, old in zip(other, one, strict=True)))


def _softened(pictures: Tensor) -> Tensor:
    """Under a binomial window: gradients of sharper pictures would not be those of what was sampled."""
    padded = F.pad(pictures[:, None], (1, 1, 1, 1), mode="replicate")[:, 0]
    rows = padded[:, :-2] + 2 * padded[:, 1:-1] + padded[:, 2:]
    return (rows[..., :-2] + 2 * rows[..., 1:-1] + rows[..., 2:]) / 16
