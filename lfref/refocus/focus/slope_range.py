"""Between which slopes a scene lies, in a tenth of a second: least squares on a few small views.

1. `reduce_views`: views on a cross through the centre, grey, small, square roots of light; shading evened out.
2. `disparity_of_reduced`: a plane sweep whose cost is a fit. For each of many slopes s the views are shifted by the
   nearest whole pixels. What is left between view k and the mean is a small displacement, which the gradient g of the
   mean explains (Lucas-Kanade): `L_k - mean = -(r p_k + e_k) g`, solved for r over a window. Here p are the steps of
   the view from the reference, e is the rounding error of the shift by whole pixels, and r is the disparity minus s.
   Each pixel takes the slope that leaves the least unexplained. The sweep covers disparities of many pixels and the
   fit fractions, so that a few slopes suffice; the variance of r is the uncertainty of a pixel. The sweep runs twice:
   over all slopes on even smaller views, then over the range that this gives. Smooth shading weighs less than
   textures.
3. `slope_range`: quantiles of the disparities that are sure and lie on a surface.
4. `scene_range`: one sweep over all slopes at which views overlap. It keeps small surfaces, and is wider than the
   scene: methods look for disparities within it.
Letters: `s r` in pixels per view step, `p e` (v, u), `g` (y, x); `S` slopes, `K` views that are read, `h w` rows and
columns of reduced pixels.
Sources: Lucas, Kanade, "An Iterative Image Registration Technique", 1981; Adelson, Wang, "Single Lens Stereo with a
Plenoptic Camera", 1992; the sweep over whole shifts is ours.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.refocus import batches

PIXELS = 25_000
"""Pixels of a reduced view, about."""
REACH = 3
"""View steps from the centre that are read: farther views are moved too far by disparities of many pixels."""
BLACK = 0.15
"""A view, or a pixel in a corner of a view, counts as black if its root of light is below this share of the reference's
mean: the edge of a black corner stands still, and looks like motion."""
LARGEST_CORNERS = 0.5
"""Share of the reference that is black corners, from which it is the scene that is black: an image circle fills .59 of
a frame of 4:3."""
TRUSTED = 0.5
"""Mean weight of the samples of a reduced pixel from which it is used."""
EVEN = 0.03
"""Largest gain of a view that is left as it is if the opposite view has the same: parallax of smooth shading looks like
that."""
WINDOW = 2
"""Reduced pixels to each side that share one disparity in a fit."""
SKIRT = 0.05
"""Weight of a window three times as wide, which decides where the inner one is flat."""
OVERLAP = 0.45
"""Share of the shorter side by which sweeps over all slopes shift the outermost view that is read, at most: operators
refuse slopes at which the corner views move by half a side."""
DETAIL = 48
"""Pixels along the shorter side of the views of `scene_range`: small surfaces still show in them."""
SPARE = 0.25
"""Share of its range that is added at either end: reduced views do not show thin things, which may be at the ends."""
BIN, FEWEST = 0.25, 6
"""Width of a bin of its disparities, in reduced pixels per view step; sure pixels that fill a bin."""
NEAR = 3
"""Reduced pixels to each side over which pictures are averaged twice for their smooth parts."""
SHADING = 0.5
"""Share of the smooth parts that stays for the fit, by trial. Sheen on a wall moves as if it lay behind the wall, and
vignetting as if it stood still; textures show where a surface is. Where there are none, this share of the shading is
enough; with .35, vignetting of glossy scenes is corrected wrongly."""
REPEATED = 0.25
"""Unexplained variance at a slope apart, of that at a smaller one, below which it counts, by trial."""
MARGIN = 0.5
"""Reduced pixels per view step that the second sweep goes beyond the result of the first."""
FAR = 2.0
"""Disparity in reduced pixels per view step from which all slopes are swept again on larger views: near surfaces are
often small, and hide in those of the first sweep."""
SEPARATE = 1.0
"""Reduced pixels per view step from which a surface beyond the range of most others is one of its own, and no stray."""
UNSURE = 0.03
"""Standard error in reduced pixels per view step at which the confidence is 1/2."""
RIVAL, ENOUGH = 0.7, 0.8
"""Two slopes compete if the unexplained variance of the better one is at least this share of the other's, and the other
one is measured by nearly as many views."""
AMBIGUOUS = 0.03
"""Share of the sure pixels with competing slopes from which the range is ambiguous: of repeated texture .04 to .3, of
other scenes at most .015, in noise of .02 too."""
CONFUSABLE = 2.5
"""Range of disparities in pixels per view step from which layers confuse light at two disparities, e apart: detail of
1 / e cycles per pixel, in a row or a column, looks alike at both, and pictures end at about .4 cycles per pixel."""
FLOOR = 1e-7
"""Variance of roots of light that good views leave; rounding to 8 bits leaves about ten times that."""
ROUNDING = 20 * FLOOR
"""Variance of dark roots of light that are rounded to 8 bits."""
SURE = 0.5
"""Confidence from which a disparity counts."""
TOGETHER = 0.1
"""Reduced pixels per view step by which neighbours on one surface differ at most."""
RARE = 0.02
"""Share of the surfaces at either end of a range that are not common: gloss, highlights, and errors."""
STRAYS = 0.005
"""Share of the sure pixels beyond either end of the range."""
LEAST_SHARE = 0.1
"""Least part of the textured picture that must be sure: unrelated pictures have none, and focal stacks .07; a capture
with noise of .2 has .11."""
LEAST_STILL = 0.8
"""The same where nothing moves: scenes that stand still have .99, and a focal stack in a row .54."""


@dataclass(frozen=True, eq=False)
class ReducedViews:
    """Square roots of grey light, which noise and highlights disturb less, of views on a cross through the centre."""

    pictures: Tensor
    """Float32, 0 where nothing can be trusted, [K, h, w]."""
    weights: Tensor
    """1 where they can be trusted, else 0, [K, h, w]."""
    indices: tuple[tuple[int, int], ...]
    """Row and column of each view in the grid, the reference first, [K]."""
    steps: Tensor
    """Positions relative to the reference, (v, u) in view steps, float64, [K, 2]."""
    factor: int
    """Pixels along each side of a reduced pixel."""

    def smaller(self, factor: int) -> "ReducedViews":
        """The same, reduced further by a whole factor."""
        pictures, weights = (F.avg_pool2d(maps[:, None], factor)[:, 0] for maps in (self.pictures, self.weights))
        return replace(self, pictures=pictures, weights=(weights > TRUSTED).float(), factor=factor * self.factor)

    def along(self, axis: int) -> "ReducedViews":
        """The reference, and the views beside it along one axis only: 0 above and below, 1 to the left and right."""
        kept = (self.steps[:, 1 - axis].abs() < 0.2).nonzero()[:, 0]  # cameras may stand a little off their line
        indices = tuple(self.indices[k] for k in kept.tolist())
        return replace(
            self, pictures=self.pictures[kept], weights=self.weights[kept], indices=indices, steps=self.steps[kept]
        )


def reduce_views(views: Tensor, weight: Tensor | None = None, positions: Tensor | None = None) -> ReducedViews:
    """Choose views of a light field [V, U, C, H, W] and reduce them."""
    height, width = views.shape[-2:]
    factor = min(max(1, round((height * width / PIXELS) ** 0.5)), height, width)
    cameras = (
        batches.even((views.shape[0], views.shape[1])) if positions is None else positions.to("cpu", torch.float64)
    )
    # A hole in the grid has weight 0 everywhere, which a few of its rows say.
    present = torch.ones(views.shape[:2], dtype=torch.bool)
    if weight is not None:
        present = (weight[..., :: max(1, weight.shape[-2] // 8), :].amax((2, 3, 4)) > 0).cpu()
    indices = _cross(present, cameras)

    def pooled(picture: Tensor) -> Tensor:
        return (picture if factor == 1 else F.avg_pool2d(picture[None], factor)[0])[0]

    light = [pooled(batches.radiance(views[index]).mean(0, keepdim=True)).cpu() for index in indices]
    pictures = torch.stack([picture.clamp(min=0).sqrt().float() for picture in light])
    weights = torch.ones_like(pictures)
    if weight is not None:
        weights = torch.stack([pooled(weight[index].float()).cpu() for index in indices])
    weights = ((weights > TRUSTED) & pictures.isfinite()).float()
    pictures = pictures.nan_to_num(0, 0, 0)
    # Neither views without light count, nor black corners of the optics: black up to the border along both axes, and
    # the two pixels beside it, which are dim.
    level = pictures.mean((1, 2))
    black = pictures < BLACK * level[0]
    along_x, along_y = ((black.cumprod(axis) + black.flip(axis).cumprod(axis).flip(axis)).bool() for axis in (2, 1))
    corners = F.max_pool2d((along_x & along_y).float(), 5, 1, 2) > 0
    corners &= corners[0].float().mean() < LARGEST_CORNERS
    weights = weights * ~(corners | (level <= BLACK * level[0])[:, None, None])
    steps = torch.stack([cameras[index] - cameras[indices[0]] for index in indices])
    return ReducedViews(_evened(pictures, weights, steps), weights, tuple(indices), steps, factor)


def _cross(present: Tensor, cameras: Tensor) -> list[tuple[int, int]]:
    """Indices of the view nearest to the centre, and of its neighbours in row and column, or else on its diagonals."""
    distance = cameras.square().sum(-1)
    number = torch.arange(present.numel()).reshape(present.shape)  # of four central views the last: 7, 7 of 14x14
    order = torch.where(present, distance - 1e-6 * number, torch.inf)
    v0, u0 = divmod(int(order.argmin()), present.shape[1])
    rows, columns = torch.meshgrid(*(torch.arange(n) for n in present.shape), indexing="ij")
    dv, du = rows - v0, columns - u0
    near = present & (dv.abs() <= REACH) & (du.abs() <= REACH) & ((dv != 0) | (du != 0))
    for on_line in ((dv == 0) | (du == 0), dv.abs() == du.abs(), torch.ones_like(near)):
        if bool((near & on_line).any()):
            return [(v0, u0), *(tuple(index) for index in (near & on_line).nonzero().tolist()[: 4 * REACH])]
    return [(v0, u0)]


def _evened(pictures: Tensor, weights: Tensor, steps: Tensor) -> Tensor:
    """Pictures divided by their smooth gain over the first one, where that is too uneven to be parallax."""
    # The gain is 1 + a quadratic polynomial, fitted on blocks, weighted by the light.
    size = min(pictures.shape[1], 8), min(pictures.shape[2], 12)
    low, sure = (F.adaptive_avg_pool2d(maps[:, None], size)[:, 0] for maps in (pictures, weights))
    weight = (sure * sure[0] * low[0].square()).flatten(1)
    ratio = (low / low[0].clamp(min=1e-6)).flatten(1) - 1
    basis = _quadratic(*size)
    normal = torch.einsum("in,kn,jn->kij", basis, weight, basis)
    # Pseudo-inverse: black views and those of a few pixels leave terms open.
    terms = torch.einsum("kij,jn,kn,kn->ki", torch.linalg.pinv(normal, hermitian=True), basis, weight, ratio)
    gain = 1 + torch.einsum("ki,in->kn", terms, basis)
    # Parallax is opposite in opposite views, and cancels in their mean.
    opposite = (steps[:, None] + steps[None]).abs().amax(2).argmin(1)
    if float(((gain + gain[opposite]) / 2 - 1).abs().max()) <= EVEN:
        return pictures
    whole = 1 + torch.einsum("ki,in->kn", terms, _quadratic(*pictures.shape[1:])).reshape(pictures.shape)
    return pictures / whole.clamp(min=0.1)


def _quadratic(height: int, width: int) -> Tensor:
    """1, x, y, x², xy, y² at pixel centres in [-1, 1], [6, height * width]."""
    y, x = ((2 * torch.arange(n) + 1.0) / n - 1 for n in (height, width))
    y, x = (grid.flatten() for grid in torch.meshgrid(y, x, indexing="ij"))
    return torch.stack([torch.ones_like(x), x, y, x * x, x * y, y * y])


class CoarseDisparity(NamedTuple):
    """Disparity of the reference view at low resolution."""

    disparity: Tensor
    """In pixels per view step, float32, [h, w]."""
    confidence: Tensor
    """1 / (1 + (standard error / .03 reduced pixels per view step)²), in [0, 1], float32, [h, w]."""
    factor: int
    """Pixels along each side of a reduced pixel."""
    is_textured: Tensor
    """Where views that agree but for rounding would give a confidence above 1/2, bool, [h, w]."""


class SlopeFit(NamedTuple):
    """Least squares at each reduced pixel, each [h, w]."""

    unexplained: Tensor
    """Variance that is left."""
    disparity: Tensor
    information: Tensor
    """Squared change that a unit of disparity makes, summed over views."""
    freedom: Tensor
    """Number of views less one."""


@torch.no_grad()
def disparity_of_reduced(reduced: ReducedViews) -> CoarseDisparity:
    """Disparity and confidence at the reference of reduced views: a sweep over all slopes, then over their range."""
    zeros = torch.zeros(reduced.pictures.shape[1:])
    nothing = CoarseDisparity(zeros, zeros, reduced.factor, zeros.bool())
    if len(reduced.indices) < 2 or min(zeros.shape) < 2:
        return nothing
    smaller = smallest(reduced)
    first = as_disparity(widest_fit(smaller), smaller.factor)
    if not bool(first.confidence.any()):
        return nothing
    sure = first.confidence >= min(SURE, float(first.confidence.quantile(0.8)))
    low, high = (first.disparity[sure].quantile(torch.tensor([0.005, 0.995])) / reduced.factor).tolist()
    low, high = _with_far_surfaces(reduced, low, high)
    return _swept(reduced, low - MARGIN, high + MARGIN)


def _with_far_surfaces(reduced: ReducedViews, low: float, high: float) -> tuple[float, float]:
    """A range in reduced pixels per view step; if it goes far, widened to the surfaces that a sweep of all slopes
    finds."""
    if max(-low, high) <= FAR:
        return low, high
    widest = _widest(reduced)
    swept = _swept(reduced, -widest, widest)
    first, last = _ends(swept, on_surfaces(swept)) or (low, high)
    return min(low, first), max(high, last)


def _ends(coarse: CoarseDisparity, sure: Tensor) -> tuple[float, float] | None:
    """First and last disparity, in reduced pixels per view step, that enough of the sure pixels have; None: none."""
    bins, counts = (coarse.disparity[sure] / coarse.factor / BIN).round().long().unique(return_counts=True)
    # A bin of few pixels is noise: of 12,000 pixels, 12 are needed.
    filled = bins[counts >= max(FEWEST, sure.numel() // 1000)]
    return (float(filled[0]) * BIN, float(filled[-1]) * BIN) if len(filled) else None


def smallest(reduced: ReducedViews) -> ReducedViews:
    """The views of the first sweep: reduced to 24 pixels along their shorter side, at most 4 times."""
    return reduced.smaller(max(1, min(4, min(reduced.pictures.shape[1:]) // 24)))


def widest_fit(reduced: ReducedViews) -> SlopeFit:
    """The best fit among all slopes at which views overlap."""
    widest = _widest(reduced)
    return best_fit(reduced, -widest, widest)


def _widest(reduced: ReducedViews) -> float:
    """Largest slope at which views overlap, in reduced pixels per view step."""
    return OVERLAP * min(reduced.pictures.shape[1:]) / max(float(reduced.steps.abs().max()), 1.0)


def _swept(reduced: ReducedViews, low: float, high: float) -> CoarseDisparity:
    """Disparity and confidence by the best fit among the slopes from `low` to `high`."""
    return as_disparity(best_fit(reduced, low, high), reduced.factor)


def best_fit(reduced: ReducedViews, low: float, high: float) -> SlopeFit:
    """The best fit among the slopes from `low` to `high`, in reduced pixels per view step."""
    fits, apart = _all_fits(reduced, low, high)
    return _best(fits, apart)


def _best(fits: Sequence[SlopeFit], apart: float) -> SlopeFit:
    """The best of fits, of which those of the least slopes come first.

    Repeated texture fits at many slopes. The least is the likeliest: one that differs by more than `apart` must be a
    much better fit.
    """
    best, *others = fits
    for fit in others:
        is_apart = (fit.disparity - best.disparity).abs() > apart
        is_better = fit.unexplained < best.unexplained * torch.where(is_apart, REPEATED, 1.0)
        best = SlopeFit(*(torch.where(is_better, new, old) for new, old in zip(fit, best, strict=True)))
    return best


def _all_fits(reduced: ReducedViews, low: float, high: float) -> tuple[list[SlopeFit], float]:
    """Fits of all slopes from `low` to `high`, the least first, and the distance up to which slopes are neighbours."""
    # Slopes at which the outermost view moves by one pixel more each.
    reach = float(reduced.steps.abs().max())
    step = 1 / max(reach, 2.0)
    n_slopes = max(2, 1 + math.ceil((high - low) / step - 1e-9))
    slopes = torch.linspace(low, high, n_slopes, dtype=torch.float64)
    most = max(step, float(slopes[1] - slopes[0]))
    pad = math.ceil(max(abs(low), abs(high)) * reach) + 1
    weights = F.pad(reduced.weights, (pad,) * 4)
    # A binomial window first: gradients of sharper pictures would not be those of what was sampled.
    padded = F.pad(_detail(reduced.pictures, reduced.weights)[:, None], (1, 1, 1, 1), mode="replicate")[:, 0]
    rows = padded[:, :-2] + 2 * padded[:, 1:-1] + padded[:, 2:]
    light = F.pad((rows[..., :-2] + 2 * rows[..., 1:-1] + rows[..., 2:]) / 16, (pad,) * 4) * weights
    slopes = slopes[slopes.abs().argsort(stable=True)]
    parts = slopes.split(max(1, 40_000 // light[0].numel()))  # many slopes of small views at once
    return [fit for part in parts for fit in fit_slopes(light, weights, reduced.steps, part, most, pad)], 3 * most


def _has_rival(fits: Sequence[SlopeFit], best: SlopeFit, apart: float) -> Tensor:
    """Where a slope apart from the best one explains the views nearly as well, bool, [h, w]."""
    rival = torch.full_like(best.unexplained, math.inf)
    for fit in fits:
        competes = ((fit.disparity - best.disparity).abs() > apart) & (fit.freedom > ENOUGH * best.freedom)
        rival = torch.where(competes, torch.minimum(rival, fit.unexplained), rival)
    return best.unexplained + FLOOR > RIVAL * (rival + FLOOR)


def _detail(pictures: Tensor, weights: Tensor) -> Tensor:
    """Pictures [K, h, w] with their smooth parts made weaker."""

    def smoothed(images: Tensor) -> Tensor:
        for _ in range(2):
            images = F.pad(images[:, None], (NEAR,) * 4, mode="replicate")
            images = F.avg_pool2d(images, 2 * NEAR + 1, 1)[:, 0]
        return images

    smooth = smoothed(pictures * weights) / smoothed(weights).clamp(min=1e-6)
    return (pictures - (1 - SHADING) * smooth) * weights


def as_disparity(best: SlopeFit, factor: int) -> CoarseDisparity:
    """Disparity and confidence of the best fit to pictures that are reduced by a factor."""
    # Variance of r: what is unexplained, over the information of all pixels of the window.
    information = (best.information * (2 * WINDOW + 1) ** 2).clamp(min=1e-12)
    confidence = torch.where(best.freedom > 0, 1 / (1 + (best.unexplained + FLOOR) / information / UNSURE**2), 0.0)
    known = confidence >= 0.02  # others take the median
    middle = best.disparity[known].median() if bool(known.any()) else 0.0
    disparity = factor * torch.where(known, best.disparity, middle)
    return CoarseDisparity(disparity, confidence, factor, ROUNDING / information < UNSURE**2)


def fit_slopes(light: Tensor, weights: Tensor, steps: Tensor, slopes: Tensor, most: float, pad: int) -> list[SlopeFit]:
    """For each of S slopes, fit the disparity r, at most `most`, that is left after the shifts, in closed form.

    Pictures and their weights, [K, h + 2 pad, w + 2 pad], have a margin of 0, at least as wide as the largest shift;
    steps [K, 2] lead from the reference to each view.
    """
    shifts = (slopes[:, None, None] * steps).round()
    offsets = torch.cat([steps.expand_as(shifts), slopes[:, None, None] * steps - shifts], 2).to(light.dtype)  # p and e
    height, width = (n - 2 * pad for n in light.shape[1:])
    moved, trust = (light.new_empty(*shifts.shape[:2], height, width) for _ in range(2))
    for s, corners in enumerate((shifts.long() + pad).tolist()):
        for k, (y, x) in enumerate(corners):
            moved[s, k] = light[k, y : y + height, x : x + width]
            trust[s, k] = weights[k, y : y + height, x : x + width]
    mean, variance, covariances = _moments(moved, trust, offsets)
    g = _gradient(mean)
    # Sums over the views of (g p) and (g e) times the four offsets and light, about their means.
    with_p, with_e = (g[0] * covariances[i] + g[1] * covariances[i + 1] for i in (0, 2))
    rise = g[0] * with_p[0] + g[1] * with_p[1]  # (g p)²
    lean = g[0] * with_p[2] + g[1] * with_p[3] + with_p[4]  # (g p) (g e + L)
    left = variance + 2 * with_e[4] + g[0] * with_e[2] + g[1] * with_e[3]  # (L + g e)²
    rise, lean, left, freedom = _windowed(torch.stack([rise, lean, left, (trust.sum(1) - 1).clamp(min=0)]))
    r = -(lean / (rise + 1e-9)).clamp(-most, most)
    unexplained = (left + 2 * r * lean + r * r * rise).clamp(min=0) / freedom.clamp(min=1e-3)
    unexplained = torch.where(freedom > 0.5, unexplained, torch.inf)
    disparity = slopes.to(r.dtype)[:, None, None] + r
    return [SlopeFit(*maps) for maps in zip(unexplained, disparity, rise, freedom, strict=True)]


def _moments(light: Tensor, weights: Tensor, offsets: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Of light and weights [S, K, h, w] and offsets [S, K, 4], over the views and about their means.

    Returns the mean of the light and the sum of its squares, [S, h, w] each, and sums of products of the four offsets
    with the four and with light, [4, 5, S, h, w].
    """
    pairs = [(i, j) for i in range(4) for j in range(i, 4)]
    first = torch.cat([torch.ones_like(offsets[..., :1]), offsets], 2)
    products = torch.stack([offsets[..., i] * offsets[..., j] for i, j in pairs], 2)
    about = torch.einsum("skn,skhw->nshw", torch.cat([first, products], 2), weights)
    lit = torch.einsum("skn,skhw->nshw", first, light)
    share = 1 / about[0].clamp(min=1e-6)
    mean, means = lit[0] * share, about[1:5] * share
    variance = torch.einsum("skhw,skhw->shw", light, light) - lit[0] * mean
    covariances = light.new_empty(4, 5, *mean.shape)
    for (i, j), product in zip(pairs, about[5:], strict=True):
        covariances[i, j] = covariances[j, i] = product - means[i] * about[1 + j]
    covariances[:, 4] = lit[1:] - means * lit[0]
    return mean, variance.clamp(min=0), covariances


def _gradient(pictures: Tensor) -> Tensor:
    """Derivatives along y and x, true to the fourth order, [2, S, h, w]."""
    # Central differences of two pixels fall short where detail is fine, and disparities would be too large.
    padded = F.pad(pictures[None], (2, 2, 2, 2), mode="replicate")[0]
    along_y, along_x = padded[..., 2:-2], padded[:, 2:-2]
    rows = 8 * (along_y[:, 3:-1] - along_y[:, 1:-3]) - (along_y[:, 4:] - along_y[:, :-4])
    columns = 8 * (along_x[..., 3:-1] - along_x[..., 1:-3]) - (along_x[..., 4:] - along_x[..., :-4])
    return torch.stack([rows, columns]) / 12


def _windowed(moments: Tensor) -> Tensor:
    """Means over the window, plus a faint share of those over nine windows side by side, [..., h, w]."""

    def boxed(images: Tensor, reach: int, stride: int) -> Tensor:
        for axis in (-2, -1):
            pad, n = reach * stride, images.shape[axis]
            padded = F.pad(images, (0, 0, pad, pad) if axis == -2 else (pad, pad, 0, 0), mode="replicate")
            images = padded.narrow(axis, 0, n).clone()
            for start in range(stride, 2 * pad + 1, stride):
                images += padded.narrow(axis, start, n)
        return images

    inner = boxed(moments, WINDOW, 1) / (2 * WINDOW + 1) ** 2
    return inner + SKIRT * (boxed(inner, 1, 2 * WINDOW + 1) / 9)


class DisparityRange(NamedTuple):
    """The disparities of a scene in pixels per view step."""

    low: float
    """Lower end."""
    middle: float
    """Mean."""
    high: float
    """Upper end."""
    sure: tuple[float, float]
    """Ends between which surfaces were found for sure."""
    common: tuple[float, float]
    """Ends without the `RARE` share of the surfaces at either side."""
    is_ambiguous: bool
    """Whether the range is wide and repeated texture fits at several disparities."""

    @property
    def is_wide(self) -> bool:
        """Whether most disparities are so far apart that filters of rows and columns confuse their light."""
        return self.common[1] - self.common[0] > CONFUSABLE


@torch.no_grad()
def scene_range(views: Tensor, weights: Tensor | None = None, positions: Tensor | None = None) -> DisparityRange | None:
    """The range in which methods look for the disparities of a light field [V, U, C, H, W]; None: nothing shows any.

    Small surfaces count too, and there is room for what reduced views do not show.
    """
    shape = (*views.shape[:2], 1, *views.shape[-2:])
    weight = None if weights is None else (weights > 0).float()[:, :, None, None, None].expand(shape)
    reduced = reduce_views(views, weight, positions)
    if len(reduced.indices) < 2 or min(reduced.pictures.shape[1:]) < 2:
        return None
    smaller = reduced.smaller(max(1, min(2, min(reduced.pictures.shape[1:]) // DETAIL)))
    widest = _widest(smaller)
    fits, apart = _all_fits(smaller, -widest, widest)
    best = _best(fits, apart)
    swept = as_disparity(best, smaller.factor)
    sure = swept.confidence >= SURE
    ends = _ends(swept, sure)
    if ends is None:
        return None
    enlarged = swept.factor / reduced.factor
    first, last = (end / enlarged for end in _with_far_surfaces(reduced, *(enlarged * end for end in ends)))
    spare = MARGIN + SPARE * (last - first)
    low, middle, high = (
        max(first - spare, -widest),
        float(swept.disparity[sure].mean()) / swept.factor,
        min(last + spare, widest),
    )
    low, middle, high, first, last = (swept.factor * value for value in (low, middle, high, first, last))
    common = swept.disparity[sure].quantile(torch.tensor([RARE, 1 - RARE])).tolist()
    found = DisparityRange(low, middle, high, (first, last), (common[0], common[1]), is_ambiguous=False)
    # In narrow ranges filters do well with wrong disparities.
    is_far = last - first > 2 * CONFUSABLE
    is_ambiguous = is_far and float(_has_rival(fits, best, apart)[sure].float().mean()) > AMBIGUOUS
    return found._replace(is_ambiguous=is_ambiguous)


@torch.no_grad()
def slope_range(coarse: CoarseDisparity) -> tuple[float, float] | None:
    """Lower and upper end of a scene's disparities, in pixels per view step; None where too little of it is sure."""
    sure, share = on_surfaces(coarse), reliable_share(coarse)
    if int((sure & coarse.is_textured).sum()) < min(50, sure.numel() / 4) or share < LEAST_SHARE:
        return None
    low, high = coarse.disparity[sure].quantile(torch.tensor([STRAYS, 1 - STRAYS])).tolist()
    # Blurred copies of one picture, as of a focal stack, seem to stand still where they happen to be alike.
    if max(abs(low), abs(high)) < UNSURE * coarse.factor and share < LEAST_STILL:
        return None
    # Small surfaces that stand alone are no strays.
    ends = _ends(coarse, sure)
    if ends is not None:
        first, last = (coarse.factor * end for end in ends)
        low = first if first < low - SEPARATE * coarse.factor else low
        high = last if last > high + SEPARATE * coarse.factor else high
    margin = 0.03 * (high - low)  # windows see less of what is small, and of the very ends
    return low - margin, high + margin


def reliable_share(coarse: CoarseDisparity) -> float:
    """Part of the textured picture whose disparity is sure and lies on a surface, [0, 1]; 1 without any texture."""
    is_reliable = on_surfaces(coarse)[coarse.is_textured]
    return float(is_reliable.float().mean()) if is_reliable.numel() else 1.0


def on_surfaces(coarse: CoarseDisparity) -> Tensor:
    """Which reduced pixels are sure and have most of their 8 neighbours on one surface with them, bool, [h, w]."""
    padded = F.pad(coarse.disparity[None, None], (1, 1, 1, 1), mode="replicate")
    around = F.unfold(padded, 3).reshape(9, *coarse.disparity.shape)
    together = ((around - coarse.disparity).abs() < TOGETHER * coarse.factor).sum(0) > 6  # itself is one of the 9
    return (coarse.confidence > SURE) & together
