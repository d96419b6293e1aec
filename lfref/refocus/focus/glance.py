"""Disparity in a tenth of a second: least squares on a few small views, after shifts by whole pixels.

For each of many slopes the views are shifted by the nearest whole pixels; what is left of their differences is then a
small displacement, which the gradient of their mean explains. Of all slopes that one counts which leaves the least
unexplained. The sweep makes hold for many pixels what least squares do within one; the least squares make a few slopes
do, and tell how sure each pixel is.
Letters: `s` slope tried, `r` what disparity has more, both in reduced pixels per view step; `p` steps of views from the
reference, `e` what the shift by whole pixels lacks; `g` gradient; `K` views, `h w` reduced pixels.
Source: Lucas, Kanade, "An Iterative Image Registration Technique", 1981; Adelson, Wang, "Single Lens Stereo with a
Plenoptic Camera", 1992.
"""

import functools
import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.refocus.focus.reduced_views import ReducedViews

WINDOW = 2  # reduced pixels to each side
SKIRT = 0.05  # weight of a window three times as wide: it speaks where the inner one sees nothing
COARSE_SIDE, COARSEST = 24, 4  # reduced pixels along the shorter side of the first look; factor at most
WIDEST = 4.0  # coarse pixels per view step: the first look reaches so far
MARGIN = 0.5  # reduced pixels per view step that the second look goes beyond the first
FLOOR = 1e-7  # variance of square roots of light: 8 bits round to about ten times that
AT_ONCE = 40_000  # pixels: small views are tried at many slopes at once
PAIRS = [(i, j) for i in range(4) for j in range(i, 4)]
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


class _Fit(NamedTuple):
    """Least squares at each reduced pixel, each [h, w]."""

    unexplained: Tensor
    """Variance that is left."""
    disparity: Tensor
    information: Tensor
    """Squared change that a unit of disparity makes, summed over views."""
    freedom: Tensor
    """Number of views less one."""


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
    return _looked(seen.smaller(max(1, min(COARSEST, min(size) // COARSE_SIDE))), -WIDEST, WIDEST)


def _looked(seen: ReducedViews, low: float, high: float) -> Glance:
    """Disparities between two slopes, in reduced pixels per view step."""
    step = 1 / max(seen.reach, 2.0)
    fit = _swept(seen, _slopes(low, high, step), step)
    confidence = _confidence(fit)
    known = confidence >= UNKNOWN
    middle = fit.disparity[known].median() if bool(known.any()) else 0.0
    return Glance(seen.factor * torch.where(known, fit.disparity, middle), confidence, seen.factor)


def _slopes(low: float, high: float, step: float) -> list[float]:
    n = 1 + math.ceil((high - low) / step - 1e-9)
    return torch.linspace(low, high, n, dtype=torch.float64).tolist()


def _confidence(fit: _Fit) -> Tensor:
    window = (2 * WINDOW + 1) ** 2
    error = (fit.unexplained + FLOOR) / (fit.information * window).clamp(min=1e-12)
    return torch.where(fit.freedom > 0, 1 / (1 + error / UNSURE**2), 0.0)


def _swept(seen: ReducedViews, slopes: list[float], step: float) -> _Fit:
    """The fit of that slope which leaves the least unexplained, at each pixel."""
    pad = math.ceil(max(abs(slopes[0]), abs(slopes[-1])) * seen.reach) + 1
    weights = F.pad(seen.weights, (pad,) * 4)
    light = F.pad(_softened(seen.pictures), (pad,) * 4) * weights
    parts = torch.tensor(slopes, dtype=torch.float64).split(max(1, AT_ONCE // light[0].numel()))
    fits = [fit for part in parts for fit in _fits(light, weights, seen.steps, part, step, pad)]
    return functools.reduce(_better, fits)


def _better(one: _Fit, other: _Fit) -> _Fit:
    is_worse = other.unexplained < one.unexplained
    return _Fit(*(torch.where(is_worse, new, old) for new, old in zip(other, one, strict=True)))


def _softened(pictures: Tensor) -> Tensor:
    """Under a binomial window: gradients of sharper pictures would not be those of what was sampled."""
    padded = F.pad(pictures[:, None], (1, 1, 1, 1), mode="replicate")[:, 0]
    rows = padded[:, :-2] + 2 * padded[:, 1:-1] + padded[:, 2:]
    return (rows[..., :-2] + 2 * rows[..., 1:-1] + rows[..., 2:]) / 16


def _fits(light: Tensor, weights: Tensor, steps: Tensor, slopes: Tensor, step: float, pad: int) -> list[_Fit]:
    """Least squares after the shift by each of S slopes: `L_k - mean = -(r p_k + e_k) g`."""
    shifts = (slopes[:, None, None] * steps).round()
    offsets = torch.cat([steps.expand_as(shifts), slopes[:, None, None] * steps - shifts], 2).to(light.dtype)
    mean, variance, covariances = _moments(
        _shifted(light, shifts, pad), trust := _shifted(weights, shifts, pad), offsets
    )
    g = _gradient(mean)
    with_p, with_e = (_along(g, covariances, first) for first in (0, 2))
    rise = g[0] * with_p[0] + g[1] * with_p[1]
    lean = g[0] * with_p[2] + g[1] * with_p[3] + with_p[4]
    left = variance + 2 * with_e[4] + g[0] * with_e[2] + g[1] * with_e[3]
    rise, lean, left, freedom = _windowed(torch.stack([rise, lean, left, (trust.sum(1) - 1).clamp(min=0)]))
    r = -(lean / (rise + 1e-9)).clamp(-step, step)
    unexplained = (left + 2 * r * lean + r * r * rise).clamp(min=0) / freedom.clamp(min=1e-3)
    unexplained = torch.where(freedom > 0.5, unexplained, torch.inf)
    disparity = slopes.to(r.dtype)[:, None, None] + r
    return [_Fit(*maps) for maps in zip(unexplained, disparity, rise, freedom, strict=True)]


def _shifted(padded: Tensor, shifts: Tensor, pad: int) -> Tensor:
    """Pictures [K, h + 2 pad, w + 2 pad] moved by whole pixels [S, K, 2], [S, K, h, w]."""
    height, width = (n - 2 * pad for n in padded.shape[1:])
    moved = padded.new_empty(*shifts.shape[:2], height, width)
    for s, corners in enumerate((shifts.long() + pad).tolist()):
        for k, (y, x) in enumerate(corners):
            moved[s, k] = padded[k, y : y + height, x : x + width]
    return moved


def _moments(light: Tensor, weights: Tensor, offsets: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Mean of the light [S, K, h, w] over views, its squares' sum about the mean, and sums about the means of products.

    Args:
        light: 0 where the weight is.
        weights: 0 or 1.
        offsets: p and e, [S, K, 4].

    Returns:
        [S, h, w]; [S, h, w]; of the four offsets with the four and with light, [4, 5, S, h, w].
    """
    first = torch.cat([torch.ones_like(offsets[..., :1]), offsets], 2)
    pairs = torch.stack([offsets[..., i] * offsets[..., j] for i, j in PAIRS], 2)
    about = torch.einsum("skn,skhw->nshw", torch.cat([first, pairs], 2), weights)
    lit = torch.einsum("skn,skhw->nshw", first, light)
    share = 1 / about[0].clamp(min=1e-6)
    mean, means = lit[0] * share, about[1:5] * share
    variance = torch.einsum("skhw,skhw->shw", light, light) - lit[0] * mean
    covariances = light.new_empty(4, 5, *mean.shape)
    for (i, j), products in zip(PAIRS, about[5:], strict=True):
        covariances[i, j] = covariances[j, i] = products - means[i] * about[1 + j]
    covariances[:, 4] = lit[1:] - means * lit[0]
    return mean, variance.clamp(min=0), covariances


def _along(g: Tensor, covariances: Tensor, first: int) -> Tensor:
    """Sums of products of `g` times offsets `first` and `first + 1` with the four offsets and with light."""
    return g[0] * covariances[first] + g[1] * covariances[first + 1]


def _gradient(pictures: Tensor) -> Tensor:
    """Derivatives along y and x, true to the fourth order, [2, S, h, w]."""
    # Central differences of two pixels fall short where detail is fine, and disparities would be too large.
    padded = F.pad(pictures[None], (2, 2, 2, 2), mode="replicate")[0]
    along_y, along_x = padded[..., 2:-2], padded[:, 2:-2]
    rows = 8 * (along_y[:, 3:-1] - along_y[:, 1:-3]) - (along_y[:, 4:] - along_y[:, :-4])
    columns = 8 * (along_x[..., 3:-1] - along_x[..., 1:-3]) - (along_x[..., 4:] - along_x[..., :-4])
    return torch.stack([rows, columns]) / 12


def _windowed(moments: Tensor) -> Tensor:
    """Means over a window with a faint skirt, [..., h, w]."""
    inner = _boxed(_boxed(moments, WINDOW, 1, -2), WINDOW, 1, -1) / (2 * WINDOW + 1) ** 2
    wide = _boxed(_boxed(inner, 1, 2 * WINDOW + 1, -2), 1, 2 * WINDOW + 1, -1) / 9
    return inner + SKIRT * wide


def _boxed(images: Tensor, reach: int, stride: int, axis: int) -> Tensor:
    """Sums of neighbours along an axis; the outermost pixel goes on beyond the border."""
    pad, n = reach * stride, images.shape[axis]
    sides = (0, 0, pad, pad) if axis == -2 else (pad, pad, 0, 0)
    padded = F.pad(images, sides, mode="replicate")
    total = padded.narrow(axis, 0, n).clone()
    for start in range(stride, 2 * pad + 1, stride):
        total += padded.narrow(axis, start, n)
    return total
