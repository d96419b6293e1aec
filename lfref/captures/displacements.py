"""Displacements of small textured patches: distances from where a view was read to where it shows the patches.

A few numbers per view are estimated from a few thousand pixels: patches with texture in two directions and one
disparity each, spread over the picture. The fit is least squares by the gradients of the views' mean. Brightness and
contrast of each view are free, so that shading causes no displacement.
Letters: `k` patch, `i` view, `c` channel, `y x` pixel row and column, `t` tap; `n a m` observation, component,
parameter of a linear model.
Source: Lucas, Kanade, "An Iterative Image Registration Technique", 1981.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.functional import interpolation

SIDE = 16  # side of a patch, in pixels
RING = 2  # pixels around a patch that are read too: gradients need two neighbours on either side
FEWEST, MOST = 24, 100  # numbers of patches, by trial; 24 are about six in each quarter
ONE_DISPARITY = 0.05  # pixels per view step, by trial: standard deviation of disparity that halves a patch's worth
HIDDEN = 0.2  # share of the contrast of the views' mean, by trial: a view with less has the patch dark or hidden
OUTLYING = 2.0  # standard deviations at which an observation counts half (Cauchy weights)
TINY = 1e-12  # keeps divisions by zero finite
BEFORE = -interpolation.TAPS[0]  # samples that interpolation needs before a position
REACH = max(BEFORE, interpolation.TAPS[-1]) + RING + 1  # pixels beyond a patch that are read, and one for movement
INSIDE = (..., slice(RING, -RING), slice(RING, -RING))


class Patches(NamedTuple):
    """Patches of the central view."""

    rows: Tensor  # first pixel row, int64, [K]
    columns: Tensor  # first pixel column, int64, [K]
    disparity: Tensor  # disparity in pixels per view step, float64, [K]

    @property
    def centres(self) -> Tensor:
        """Row and column of each centre in pixels from the top left sample, float64, [K, 2]."""
        return torch.stack([self.rows, self.columns], -1) + (SIDE - 1) / 2


def choose_patches(grey: Tensor, disparity: Tensor, positions: Tensor, n_channels: int) -> Patches:
    """The best patch of each cell of the central view [H, W], for views at these positions [I, 2]."""
    # About 2^22 samples of all patches in all views and channels, by trial, to limit the time.
    count = min(MOST, max(FEWEST, (1 << 22) // (len(positions) * n_channels * (SIDE + 2 * RING) ** 2)))
    stride = SIDE // 2
    y, x = torch.gradient(grey)
    moments = torch.stack([y * y, y * x, x * x, disparity, disparity.square()])
    yy, yx, xx, mean, square = F.avg_pool2d(moments[None], SIDE, stride)[0]
    # The smaller eigenvalue of the structure tensor: texture in both directions. Stripes count a little.
    least = (yy + xx) / 2 - ((yy - xx).square() / 4 + yx.square()).sqrt()
    detail = least.clamp(min=0) + 0.02 * (yy + xx)
    worth = detail / (1 + (square - mean.square()).clamp(min=0) / ONE_DISPARITY**2)
    # Patches must lie inside all views.
    reach = mean.abs() * float(positions.abs().max()) + REACH
    tops, lefts = (stride * torch.arange(n) for n in worth.shape)
    below, right = grey.shape[0] - SIDE - tops, grey.shape[1] - SIDE - lefts
    room = torch.minimum(torch.minimum(tops, below)[:, None], torch.minimum(lefts, right))
    worth = torch.where(room > reach, worth, 0.0)
    side = max(2, round(math.sqrt(worth.numel() / count)))
    best, index = F.max_pool2d(worth[None], side, ceil_mode=True, return_indices=True)
    index = index.flatten()[best.flatten() > 0]
    row, column = index // worth.shape[1], index % worth.shape[1]
    return Patches(tops[row], lefts[column], mean.flatten()[index].double())


def read_patches(views: Tensor, patches: Patches, displacements: Tensor) -> Tensor:
    """Patches with their ring, each view read lower and farther right by displacements [K, I, 2]: [K, I, C, 20, 20]."""
    views, starts = views.float(), torch.stack([patches.rows, patches.columns], -1)[:, None] - RING + displacements
    side = SIDE + 2 * RING
    last = torch.tensor(views.shape[-2:]) - side - len(interpolation.TAPS) + BEFORE
    starts = torch.minimum(starts.clamp(min=BEFORE), last.to(starts))
    whole = starts.floor()
    # Matrices from the samples that a patch may read to those between them, [K, I, 2, side, side + T - 1].
    weights = interpolation.weights(starts - whole).to(views)
    n_taps = len(interpolation.TAPS)
    matrices = torch.zeros(*weights.shape[:3], side, side + n_taps - 1).to(views)
    for tap in range(n_taps):
        matrices.diagonal(tap, -2, -1).copy_(weights[..., tap, None])
    along = torch.arange(side + n_taps - 1)
    rows, columns = ((whole.long() - BEFORE)[..., None] + along).unbind(2)
    view = torch.arange(len(views))[:, None, None, None]
    channel = torch.arange(views.shape[1])[:, None, None]
    # One patch at a time, in all views, stays in the processor's cache.
    read = [
        down[:, None] @ views[view, channel, y[:, None, :, None], x[:, None, None, :]] @ across[:, None].mT
        for (down, across), y, x in zip(matrices.transpose(1, 2), rows, columns, strict=True)
    ]
    return torch.stack(read)


class Observed(NamedTuple):
    """Displacements of patches as normal equations: `moments = information @ displacement`."""

    information: Tensor  # sums of products of gradients (down, right), float64, [K, C, 2, 2]
    moments: Tensor  # sums of products of gradients and light, float64, [K, I, C, 2]
    rest: Tensor  # sums of squares that displacements do not explain, float64, [K, I, C]
    templates: Tensor  # mean of the views, [K, C, h, w]
    shown: Tensor  # 1 where a view shows a patch about as clearly as the others, else 0, [K, I]


def observe(samples: Tensor, shown: Tensor) -> Observed:
    """Displacements of patches [K, I, C, h, w] that views show (1, else 0, [K, I]) against the mean of all views."""
    share = (shown / shown.sum(1, keepdim=True).clamp(min=1)).to(samples)
    templates = torch.einsum("ki,kichw->kchw", share, samples)
    basis = texture(templates)
    light = samples[INSIDE].flatten(3).movedim(1, 2)
    products = (light @ basis).double()  # [K, C, I, 3]
    gram = (basis.mT @ basis).double()  # [K, C, 3, 3]
    own = light.var(-1, correction=0).double() * light.shape[-1]
    shown = shown * ((products[..., 0] / gram[:, :, :1, 0].clamp(min=TINY)).mean(1) > HIDDEN)
    # The template's own share is eliminated: each view has its own contrast.
    power = gram[..., :1, :1].clamp(min=TINY)
    contrast = products[..., :1] / power
    usable = contrast.clamp(min=HIDDEN)
    shared = gram[..., 1:, :1] / power
    information = gram[..., 1:, 1:] - shared @ gram[..., :1, 1:]
    along = products[..., 1:] - products[..., :1] @ shared.mT
    # L(x + e) rises by the gradient times e: where a view rises, its patch lies towards the other side.
    moments = -along / usable
    moved = moments @ ridged(information).inverse()
    rest = own - (contrast * products[..., :1])[..., 0]
    rest = (rest / usable[..., 0].square() - (moved * moments).sum(-1)).clamp(min=0)
    return Observed(information, moments.movedim(1, 2), rest.movedim(1, 2), templates, shown)


def texture(templates: Tensor) -> Tensor:
    """Light and its gradients down and right, each about its mean, within the ring: [..., h, w] -> [..., pixels, 3]."""

    def gradient(axis: int) -> Tensor:
        # Exact for polynomials of degree 4.
        near, far = (templates.roll(-n, axis) - templates.roll(n, axis) for n in (1, 2))
        return ((8 * near - far) / 12)[INSIDE]

    parts = torch.stack([templates[INSIDE], gradient(-2), gradient(-1)], -1).flatten(-3, -2)
    return parts - parts.mean(-2, keepdim=True)


def ridged(matrix: Tensor) -> Tensor:
    """A 2x2 matrix with a small ridge, so that it has an inverse: a direction without texture has displacement 0."""
    size = matrix.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    return matrix + (1e-9 * size + TINY) * torch.eye(2, dtype=matrix.dtype)


class Fitted(NamedTuple):
    """Parameters of a linear model, and their errors."""

    values: Tensor  # values of the parameters, [M]
    errors: Tensor  # standard errors, from the scatter of observations, [M]
    effect: float  # root mean square of the model's predictions
    scatter: float  # robust standard deviation of the residuals


def fit_linear(model: Tensor, observations: Tensor, information: Tensor, prior: Tensor | None = None) -> Fitted:
    """Fit observations [N, A] by a linear model [N, A, M], by iterated least squares that give outliers less weight.

    `information` is the inverse covariance of each observation, up to a common factor, [N, A, A]; `prior` the inverse
    variance of each parameter about 0 before any observation, [M].
    """
    counts = information.diagonal(dim1=-2, dim2=-1).sum(-1) > 0
    if bool(counts.any()):  # the others would make the typical residual look small
        model, observations, information = model[counts], observations[counts], information[counts]
    trust = torch.ones(len(observations), dtype=observations.dtype)
    known = torch.zeros(model.shape[-1], dtype=observations.dtype) if prior is None else prior
    typical = torch.tensor(1.0)
    for _ in range(8):  # number of rounds by trial
        weighted = trust[:, None, None] * (information @ model)
        normal = torch.einsum("nai,naj->ij", weighted, model)
        normal = normal + torch.diag(typical * known + TINY * (1 + normal.diagonal().mean()))
        values = torch.linalg.solve(normal, torch.einsum("nai,na->i", weighted, observations))
        rest = observations - model @ values
        outlying = torch.einsum("na,nab,nb->n", rest, information, rest)
        typical = (outlying.median() / observations.shape[1]).clamp(min=TINY)
        trust = 1 / (1 + outlying / (OUTLYING**2 * observations.shape[1] * typical))
    pulls = torch.linalg.solve(normal, torch.einsum("nai,na->in", weighted, rest))
    weight = trust * information.diagonal(dim1=-2, dim2=-1).sum(-1)
    total = weight.sum().clamp(min=TINY)
    # An outlier loses weight as it moves away: it holds the parameters by only 2 t - 1 of its weight.
    hold = (((2 * trust - 1) * weight).sum() / total).clamp(min=0.2)
    effect = (((model @ values).square().mean(-1) * weight).sum() / total).sqrt()
    # Weighted median of the residuals' lengths, scaled to a standard deviation.
    lengths, order = rest.norm(dim=-1).sort()
    below = weight[order].cumsum(0) / total
    median = float(lengths[int((below < 0.5).sum().clamp(max=len(lengths) - 1))])
    return Fitted(values, pulls.square().sum(1).sqrt() / hold, float(effect), 1.48 * median)
