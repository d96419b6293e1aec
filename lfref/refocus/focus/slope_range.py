"""The slopes between which a scene lies: those of what is seen well, a few strays at either end left out."""

import functools
import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.refocus import batches

# PART slope_fit
# Least squares for the small displacement that is left between views which a slope has shifted by whole pixels.
#
# Letters: `s` slope tried, `r` what disparity has more, both in pixels per view step; `p` steps of views from the
# reference, `e` what the shift by whole pixels lacks; `g` gradient of the mean; `S` slopes, `K` views, `h w` pixels.
# Source: Lucas, Kanade, "An Iterative Image Registration Technique", 1981.

WINDOW = 2  # reduced pixels to each side
SKIRT = 0.05  # weight of a window three times as wide: it speaks where the inner one sees nothing
PAIRS = [(i, j) for i in range(4) for j in range(i, 4)]


class Fit(NamedTuple):
    """Least squares at each reduced pixel, each [h, w]."""

    unexplained: Tensor
    """Variance that is left."""
    disparity: Tensor
    information: Tensor
    """Squared change that a unit of disparity makes, summed over views."""
    freedom: Tensor
    """Number of views less one."""


def fits_of_slope_fit(
    light: Tensor, weights: Tensor, steps: Tensor, slopes: Tensor, step: float, pad: int
) -> list[Fit]:
    """Fit the disparity that is left after the shift by each of S slopes: `L_k - mean = -(r p_k + e_k) g`.

    Args:
        light: Pictures, 0 where their weight is, with a margin, [K, h + 2 pad, w + 2 pad].
        weights: 0 or 1, in the margin 0, of the same shape.
        steps: Of each view from the reference, (v, u), float64, [K, 2].
        slopes: In pixels per view step, float64, [S].
        step: Most that disparity may differ from a slope.
        pad: Of the margin, at least as far as a slope shifts a view.

    Returns:
        A fit for each slope.
    """
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
    return [Fit(*maps) for maps in zip(unexplained, disparity, rise, freedom, strict=True)]


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


# PART reduced_views
# A few views around the centre of the grid, small and grey: what quick looks at a light field are made of.
#
# Letters: `K` views looked at, `h w` rows and columns of reduced pixels.

PIXELS = 25_000  # of a reduced view, about
REACH = 3  # view steps from the centre: disparities of many pixels move views beyond it too far
BLACK = 0.1  # of the reference's brightness, roots of light like all here: darker views show nothing
BLACK_CORNER, FADE = 0.15, 2  # of it: pixels of black corners are darker; reduced pixels beside them that are dim
TRUSTED = 0.5  # mean weight of the samples of a reduced pixel from which it is believed
OFF_LINE = 0.2  # view steps that a camera may stand off a row or column
EVEN = 0.03  # spread of the gain of a view below which it is taken for parallax of smooth shading


@dataclass(frozen=True, eq=False)
class ReducedViews:
    """Square roots of grey light, which noise and highlights disturb less, of views on a cross through the centre."""

    pictures: Tensor
    """Float32, 0 where nothing can be trusted, [K, h, w]."""
    weights: Tensor
    """1 where they can be trusted, else 0, [K, h, w]."""
    places: tuple[tuple[int, int], ...]
    """Row and column of each view in the grid, the reference first, [K]."""
    steps: Tensor
    """Places relative to the reference, (v, u) in view steps, float64, [K, 2]."""
    factor: int
    """Pixels along each side of a reduced pixel."""

    @property
    def reach(self) -> float:
        """Greatest distance of a view from the reference along either axis, in view steps."""
        return float(self.steps.abs().max())

    def smaller(self, factor: int) -> "ReducedViews":
        """The same, reduced further by a whole factor."""
        if factor == 1:
            return self
        pictures, weights = (F.avg_pool2d(each[:, None], factor)[:, 0] for each in (self.pictures, self.weights))
        return replace(self, pictures=pictures, weights=(weights > TRUSTED).float(), factor=factor * self.factor)

    def along(self, axis: int) -> "ReducedViews":
        """The reference, and what lies beside it along one axis only: 0 above and below, 1 to the left and right."""
        kept = (self.steps[:, 1 - axis].abs() < OFF_LINE).nonzero()[:, 0]
        places = tuple(self.places[k] for k in kept.tolist())
        return replace(
            self, pictures=self.pictures[kept], weights=self.weights[kept], places=places, steps=self.steps[kept]
        )


def reduced(
    views: Tensor, weight: Tensor | None = None, positions: Tensor | None = None, pixels: int = PIXELS
) -> ReducedViews:
    """Choose views and reduce them.

    Views whose brightness differs smoothly from that of the reference are evened: vignetting and exposure would be
    taken for motion of shading.

    Args:
        views: Floating point, uint8 or uint16, [V, U, C, H, W].
        weight: How far each sample is to be trusted, in [0, 1], [V, U, 1, H, W]; None: fully.
        positions: Of each camera in view steps, (v, u), [V, U, 2]; None: the even grid.
        pixels: Of a reduced view, about.
    """
    height, width = views.shape[-2:]
    factor = min(max(1, round((height * width / pixels) ** 0.5)), height, width)
    where = _positions(views) if positions is None else positions.to("cpu", torch.float64)
    places = _cross(_present(views, weight), where)
    pictures = torch.stack([_grey(views[place], factor) for place in places])
    weights = torch.ones_like(pictures)
    if weight is not None:
        weights = torch.stack([_pooled(weight[place].float(), factor)[0] for place in places])
    weights = ((weights > TRUSTED) & pictures.isfinite()).float()
    pictures = pictures.nan_to_num(0, 0, 0)
    weights = weights * ~_unlit(pictures)
    steps = torch.stack([where[place] - where[places[0]] for place in places])
    return ReducedViews(_evened(pictures, weights, steps), weights, tuple(places), steps, factor)


def _positions(views: Tensor) -> Tensor:
    v, u = (geometry.angular_offsets(n) for n in views.shape[:2])
    return torch.stack(torch.meshgrid(v, u, indexing="ij"), -1)


def _present(views: Tensor, weight: Tensor | None) -> Tensor:
    """Which views there are: a hole has weight 0 everywhere, [V, U]."""
    if weight is None:
        return torch.ones(views.shape[:2], dtype=torch.bool)
    # A few rows of every view will do.
    return (weight[..., :: max(1, weight.shape[-2] // 8), :].amax((2, 3, 4)) > 0).cpu()


def _cross(present: Tensor, positions: Tensor) -> list[tuple[int, int]]:
    """The view next to the centre, and those near it in its row and column; in its diagonals where there are none."""
    distance = positions.square().sum(-1)
    later = torch.arange(present.numel()).reshape(present.shape)  # of the central four the last: 7, 7 of 14x14
    order = torch.where(present, distance - 1e-6 * later, torch.inf)
    v0, u0 = divmod(int(order.argmin()), present.shape[1])
    rows, columns = torch.meshgrid(*(torch.arange(n) for n in present.shape), indexing="ij")
    dv, du = rows - v0, columns - u0
    near = present & (dv.abs() <= REACH) & (du.abs() <= REACH) & ((dv != 0) | (du != 0))
    for on_line in ((dv == 0) | (du == 0), dv.abs() == du.abs(), torch.ones_like(near)):
        if bool((near & on_line).any()):
            return [(v0, u0), *(tuple(place) for place in (near & on_line).nonzero().tolist()[: 4 * REACH])]
    return [(v0, u0)]


def _grey(view: Tensor, factor: int) -> Tensor:
    return _pooled(batches.radiance(view).mean(0, keepdim=True), factor)[0].clamp(min=0).sqrt().float()


def _unlit(pictures: Tensor) -> Tensor:
    """Views without light, and corners that the optics leave black: their edge stands still, and looks like motion."""
    light = pictures.mean((1, 2))
    black = pictures < BLACK_CORNER * light[0]
    sides, ends = ((_run(black, axis) | _run(black.flip(axis), axis).flip(axis)) for axis in (2, 1))
    corners = F.max_pool2d((sides & ends).float(), 2 * FADE + 1, 1, FADE) > 0
    return corners | (light <= BLACK * light[0])[:, None, None]


def _run(black: Tensor, axis: int) -> Tensor:
    """Which pixels are black with all before them along an axis."""
    return black.cumprod(axis).bool()


def _pooled(picture: Tensor, factor: int) -> Tensor:
    return picture if factor == 1 else F.avg_pool2d(picture[None], factor)[0]


def _evened(pictures: Tensor, weights: Tensor, steps: Tensor) -> Tensor:
    """Pictures divided by their smooth gain over the first one, where it is too uneven to be parallax."""
    size = min(pictures.shape[1], 8), min(pictures.shape[2], 12)
    low, sure = (F.adaptive_avg_pool2d(each[:, None], size)[:, 0] for each in (pictures, weights))
    weight = (sure * sure[0] * low[0].square()).flatten(1)
    ratio = (low / low[0].clamp(min=1e-6)).flatten(1) - 1
    basis = _quadratic(*size)
    normal = torch.einsum("in,kn,jn->kij", basis, weight, basis)
    # Black views and those of a few pixels leave terms open.
    solved = torch.linalg.pinv(normal, hermitian=True)
    terms = torch.einsum("kij,jn,kn,kn->ki", solved, basis, weight, ratio)
    gain = 1 + torch.einsum("ki,in->kn", terms, basis)
    if not _is_uneven(gain, steps):
        return pictures
    whole = 1 + torch.einsum("ki,in->kn", terms, _quadratic(*pictures.shape[1:])).reshape(pictures.shape)
    return pictures / whole.clamp(min=0.1)


def _is_uneven(gain: Tensor, steps: Tensor) -> bool:
    """Whether gains [K, n] are more than parallax, which is opposite in opposite views."""
    opposite = (steps[:, None] + steps[None]).abs().amax(2).argmin(1)
    return float(((gain + gain[opposite]) / 2 - 1).abs().max()) > EVEN


def _quadratic(height: int, width: int) -> Tensor:
    """1, x, y, x², xy, y² at pixel centres in [-1, 1], [6, height * width]."""
    y, x = ((2 * torch.arange(n) + 1.0) / n - 1 for n in (height, width))
    y, x = (each.flatten() for each in torch.meshgrid(y, x, indexing="ij"))
    return torch.stack([torch.ones_like(x), x, y, x * x, x * y, y * y])


# PART glance
# Disparity in a tenth of a second: least squares on a few small views, after shifts by whole pixels.
#
# For each of many slopes the views are shifted by the nearest whole pixels; what is left of their differences is then a
# small displacement, which the gradient of their mean explains. Of all slopes that one counts which leaves the least
# unexplained. The sweep makes hold for many pixels what least squares do within one; the least squares make a few
# slopes
# do, and tell how sure each pixel is.
# Letters: `h w` rows and columns of reduced pixels.
# Source: Adelson, Wang, "Single Lens Stereo with a Plenoptic Camera", 1992; the sweep over shifts is ours.

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
        >>> from lfref.refocus.focus.slope_range import reduced
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
    widest = WIDEST * min(1.0, REACH / seen.reach) if seen.reach else WIDEST
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
    window = (2 * WINDOW + 1) ** 2
    error = (fit.unexplained + FLOOR) / (fit.information * window).clamp(min=1e-12)
    return torch.where(fit.freedom > 0, 1 / (1 + error / UNSURE**2), 0.0)


def _swept(seen: ReducedViews, slopes: list[float], step: float) -> Fit:
    """The fit of that slope which leaves the least unexplained, at each pixel."""
    pad = math.ceil(max(abs(slopes[0]), abs(slopes[-1])) * seen.reach) + 1
    weights = F.pad(seen.weights, (pad,) * 4)
    light = F.pad(_softened(seen.pictures), (pad,) * 4) * weights
    parts = torch.tensor(slopes, dtype=torch.float64).split(max(1, AT_ONCE // light[0].numel()))
    fits = [fit for part in parts for fit in fits_of_slope_fit(light, weights, seen.steps, part, step, pad)]
    return functools.reduce(_better, fits)


def _better(one: Fit, other: Fit) -> Fit:
    is_worse = other.unexplained < one.unexplained
    return Fit(*(torch.where(is_worse, new, old) for new, old in zip(other, one, strict=True)))


def _softened(pictures: Tensor) -> Tensor:
    """Under a binomial window: gradients of sharper pictures would not be those of what was sampled."""
    padded = F.pad(pictures[:, None], (1, 1, 1, 1), mode="replicate")[:, 0]
    rows = padded[:, :-2] + 2 * padded[:, 1:-1] + padded[:, 2:]
    return (rows[..., :-2] + 2 * rows[..., 1:-1] + rows[..., 2:]) / 16


SURE = 0.5  # confidence
TOGETHER, NEIGHBOURS = 0.1, 6  # a surface: so many of the 8 neighbours differ by less than that, in reduced pixels
STRAYS = 0.01  # of what is seen, left out at either end
MARGIN_OF_SLOPE_RANGE = 0.03  # of the range, added at either end: windows see less of what is small
FEWEST = 50  # reduced pixels that must be seen


@torch.no_grad()
def slope_range(seen: Glance) -> tuple[float, float] | None:
    """The range of disparities of a scene.

    Args:
        seen: First look at it.

    Returns:
        Lower and upper end, in pixels per view step; None where too little is seen well.

    Example:
        >>> from lfref.refocus.focus.slope_range import glance
        >>> from lfref.refocus.focus.slope_range import reduced
        >>> slope_range(glance(reduced(torch.full((5, 5, 3, 64, 64), 0.5)))) is None
        True
    """
    sure = well_seen(seen)
    if int(sure.sum()) < min(FEWEST, sure.numel() / 4):
        return None
    low, high = seen.disparity[sure].quantile(torch.tensor([STRAYS, 1 - STRAYS])).tolist()
    margin = MARGIN_OF_SLOPE_RANGE * (high - low)
    return low - margin, high + margin


def well_seen(seen: Glance) -> Tensor:
    """Which reduced pixels are sure and lie on a surface, bool, [h, w].

    Args:
        seen: First look.
    """
    padded = F.pad(seen.disparity[None, None], (1, 1, 1, 1), mode="replicate")
    around = F.unfold(padded, 3).reshape(9, *seen.disparity.shape)
    together = ((around - seen.disparity).abs() < TOGETHER * seen.factor).sum(0) > NEIGHBOURS
    return (seen.confidence > SURE) & together


# PART view_axes
# Do rows and columns of views tell the same disparities? Where one axis is reversed they tell opposite ones.
#
# Reversing both axes only swaps the sign of the slope; with one reversed nothing but slope 0 comes into focus.

# confidence, along both axes
LEAST_SHARE = 0.02  # of the picture that must be sure
LEAST_MOTION = 0.03  # of that part, in coarse pixels per view step: below, signs mean nothing
AGREE = 0.5  # correlation: simulated scenes of all kinds have .74 to 1, with one axis reversed -.74 to -1


def seems_reversed(seen: ReducedViews) -> bool:
    """Whether one axis of the views is reversed: which one cannot be told, nor matters.

    Args:
        seen: Reduced views; of a single row or column nothing is known.

    Example:
        >>> from lfref.refocus.focus.slope_range import reduced
        >>> seems_reversed(reduced(torch.rand(1, 5, 3, 64, 64)))
        False
    """
    return correlation(seen) < -AGREE


@torch.no_grad()
def correlation(seen: ReducedViews) -> float:
    """Of the disparities that the column of views tells with those of the row, -1 to 1; 0 where nothing is known.

    Args:
        seen: Reduced views.
    """
    lines = [seen.along(axis) for axis in (0, 1)]
    if min(len(line.places) for line in lines) < 2:
        return 0.0
    column, row = (first_look(line) for line in lines)
    sure = (column.confidence > SURE) & (row.confidence > SURE)
    if float(sure.float().mean()) < LEAST_SHARE:
        return 0.0
    both = torch.stack([column.disparity[sure], row.disparity[sure]])
    motion = both.square().mean(1).sqrt()
    if float(motion.min()) < LEAST_MOTION * row.factor:
        return 0.0
    return float((both[0] * both[1]).mean() / motion.prod())
