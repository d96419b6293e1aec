"""How far patches of each view lie from where they were read: least squares by the gradients of the views' mean.

Brightness and contrast of each patch are its own, so that what shades a view does not move it.
Letters: `k` patch, `i` view, `c` channel, `y x` pixel row and column.
Source: Lucas, Kanade, "An Iterative Image Registration Technique", 1981.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.functional import jit, threads
from lfref.simulator.effects import displacement

# PART patch_loop
# The compiled loop that reads small patches of views between their samples.
#
# Letters: `k` patch, `i` view, `c` channel, `y x` pixel row and column, `t` tap.


@jit.compiled
def read(views, channels, rows, columns, row_weights, column_weights, patches, first, last):  # type: ignore[no-untyped-def]
    """Fill the patches from `first` to before `last`.

    Args:
        views: Samples, [I, all channels, H, W].
        channels: Which of their channels are read, [C].
        rows: First row that a patch takes of a view, [K, I].
        columns: Likewise, [K, I].
        row_weights: Weights of rows side by side, [K, I, T].
        column_weights: Likewise, [K, I, T].
        patches: What to fill, float32, [K, I, C, h, w].
        first: Number of the first patch.
        last: Number after the last patch.
    """
    n_views, n_channels, height, width = patches.shape[1:]
    taps = row_weights.shape[2]
    line = np.empty(width + taps - 1, np.float32)
    for k in range(first, last):
        for i in range(n_views):
            top, left = rows[k, i], columns[k, i]
            down, across = row_weights[k, i], column_weights[k, i]
            for c in range(n_channels):
                view = views[i, channels[c]]
                for y in range(height):
                    line[:] = 0
                    for t in range(taps):
                        # Slices begin at 0: an index that might be negative would keep the loop from going in steps.
                        weight, source = down[t], view[top + y + t, left : left + len(line)]
                        for x in range(len(line)):
                            line[x] += weight * source[x]
                    made = patches[k, i, c, y]
                    made[:] = 0
                    for t in range(taps):
                        weight, source = across[t], line[t : t + width]
                        for x in range(width):
                            made[x] += weight * source[x]


# PART patches
# Small textured patches of the central view, and the same patches as every view shows them.
#
# What is to be known of a few numbers a view is known from a few thousand pixels: patches whose texture has two
# directions, at one disparity each, spread over the picture.
# Letters: `k` patch, `i` view, `c` channel, `y x` pixel row and column, `T` tap.

SIDE = 16  # pixels of a patch
RING = 2  # pixels around it that are read with it, for gradients
SAMPLES = 1 << 22  # of all patches in all views and channels, about
FEWEST, MOST = 24, 100  # patches looked for
SPREAD = 0.05  # standard deviation of disparity in a patch that halves its worth
BEFORE = -displacement.TAPS[0]
REACH = max(BEFORE, displacement.TAPS[-1]) + RING + 1  # pixels beyond a patch that are read, and one to move
WORTH_A_THREAD = 1 << 16


class Patches(NamedTuple):
    """Where the patches lie in the central view, and how much nearer than the focus they are."""

    rows: Tensor
    """First pixel row of each, int64, [K]."""
    columns: Tensor
    """First pixel column, int64, [K]."""
    disparity: Tensor
    """In pixels per view step, float64, [K]."""

    @property
    def centres(self) -> Tensor:
        """Middles of the patches, (row, column) in pixels from the top left sample, float64, [K, 2]."""
        return torch.stack([self.rows, self.columns], -1) + (SIDE - 1) / 2


def chosen(grey: Tensor, disparity: Tensor, places: Tensor, n_channels: int) -> Patches:
    """Choose patches that tell most: one for each cell of the picture, the best of those that lie there.

    Args:
        grey: Central view, [H, W].
        disparity: Of its pixels, in pixels per view step, [H, W].
        places: Of the views that are to show them, (v, u) from the angular centre, [I, 2].
        n_channels: That will be read.
    """
    wanted = min(MOST, max(FEWEST, SAMPLES // (len(places) * n_channels * (SIDE + 2 * RING) ** 2)))
    worth, middle = _worth(grey, disparity)
    reach = middle.abs() * float(places.abs().max()) + REACH
    stride = SIDE // 2
    tops, lefts = (stride * torch.arange(n) for n in worth.shape)
    rows_left, columns_left = grey.shape[0] - SIDE - tops, grey.shape[1] - SIDE - lefts
    room = torch.minimum(torch.minimum(tops, rows_left)[:, None], torch.minimum(lefts, columns_left))
    worth = torch.where(room > reach, worth, 0.0)
    side = max(2, round(math.sqrt(worth.numel() / wanted)))
    best, index = F.max_pool2d(worth[None], side, ceil_mode=True, return_indices=True)
    index = index.flatten()[best.flatten() > 0]
    at_row, at_column = index // worth.shape[1], index % worth.shape[1]
    return Patches(tops[at_row], lefts[at_column], middle.flatten()[index].double())


def _worth(grey: Tensor, disparity: Tensor) -> tuple[Tensor, Tensor]:
    """How well patches every half a side tell where they lie, and their disparity."""
    stride = SIDE // 2
    y, x = torch.gradient(grey)
    moments = torch.stack([y * y, y * x, x * x, disparity, disparity.square()])
    yy, yx, xx, mean, square = F.avg_pool2d(moments[None], SIDE, stride)[0]
    least = (yy + xx) / 2 - ((yy - xx).square() / 4 + yx.square()).sqrt()
    # Stripes too tell something, if only across themselves.
    detail = least.clamp(min=0) + 0.02 * (yy + xx)
    return detail / (1 + (square - mean.square()).clamp(min=0) / SPREAD**2), mean


def read_patches(
    views: Tensor, patches: Patches, displacements: Tensor, channels: Sequence[int] | None = None
) -> Tensor:
    """Patches with a ring of `RING` pixels around them, as views show them.

    Args:
        views: Floating point, CPU, [I, C, H, W].
        patches: Which.
        displacements: How much lower and farther right each view is read, in pixels, float64, [K, I, 2].
        channels: Which are read; None: all.

    Returns:
        Samples between samples, float32, [K, I, C, SIDE + 2 RING, SIDE + 2 RING].
    """
    starts = torch.stack([patches.rows, patches.columns], -1)[:, None] - RING + displacements
    side = SIDE + 2 * RING
    last = torch.tensor(views.shape[-2:]) - side - len(displacement.TAPS) + BEFORE
    starts = torch.minimum(starts.clamp(min=BEFORE), last.to(starts))
    whole = starts.floor()
    weights = displacement.weights(starts - whole).float()
    rows, columns = (whole.long() - BEFORE).unbind(-1)
    wanted = torch.tensor(range(views.shape[1]) if channels is None else channels)
    made = torch.empty(len(rows), len(views), len(wanted), side, side)
    tables = (wanted, rows, columns, weights[:, :, 0], weights[:, :, 1], made)
    arrays = [table.contiguous().numpy() for table in tables]
    n_threads = threads.worthwhile(made.numel(), WORTH_A_THREAD)
    samples = views.detach().numpy()
    threads.share(
        lambda first, last: read(samples, *arrays, first, last),
        threads.bands(len(made), n_threads),
        n_threads,
    )
    return made


FAINT = 1e-12
FAINTEST = 0.2  # contrast of a patch over that of the mean of all views, below which it is dark or hidden
INSIDE = (..., slice(RING, -RING), slice(RING, -RING))


class Observed(NamedTuple):
    """Displacements of patches, each with what it is worth: `moments = information @ displacement`."""

    information: Tensor
    """Of a displacement (down, right): products of gradients summed, float64, [K, C, 2, 2]."""
    moments: Tensor
    """Float64, [K, I, C, 2]."""
    rest: Tensor
    """Squares of what displacements do not explain, summed, float64, [K, I, C]."""
    templates: Tensor
    """What the views show on the average, [K, C, h, w]."""
    shown: Tensor
    """1 where a view shows a patch about as clearly as the others do, else 0, [K, I]."""

    def moved(self, by: Tensor) -> "Observed":
        """The same with displacements that are larger by so much, [K, I, 2]."""
        return self._replace(moments=self.moments + torch.einsum("kcab,kib->kica", self.information, by))


def observed(samples: Tensor, shown: Tensor) -> Observed:
    """How far each patch lies from the mean of all views; brightness and contrast of each are its own.

    Args:
        samples: With a ring for gradients, [K, I, C, h, w].
        shown: 1 where a view shows a patch, else 0, [K, I].
    """
    share = (shown / shown.sum(1, keepdim=True).clamp(min=1)).to(samples)
    templates = torch.einsum("ki,kichw->kchw", share, samples)
    basis = texture(templates)
    light = samples[INSIDE].flatten(3).movedim(1, 2)
    products = (light @ basis).double()
    gram = (basis.mT @ basis).double()
    own = light.var(-1, correction=0).double() * light.shape[-1]
    contrast = products[..., 0] / gram[:, :, :1, 0].clamp(min=FAINT)
    shown = shown * (contrast.mean(1) > FAINTEST)
    return Observed(*_displaced(products, gram, own), templates, shown)


def texture(templates: Tensor) -> Tensor:
    """Light and its gradients down and right, each about its mean, within the ring: [..., h, w] -> [..., pixels, 3]."""
    down, right = (_gradient(templates, axis)[INSIDE] for axis in (-2, -1))
    parts = torch.stack([templates[INSIDE], down, right], -1).flatten(-3, -2)
    return parts - parts.mean(-2, keepdim=True)


def _gradient(pictures: Tensor, axis: int) -> Tensor:
    """Differences of neighbours and of next ones, exact for polynomials of degree 4."""
    near, far = (pictures.roll(-n, axis) - pictures.roll(n, axis) for n in (1, 2))
    return (8 * near - far) / 12


def _displaced(products: Tensor, gram: Tensor, own: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Information, moments and rest of patches.

    Args:
        products: Of light with texture and its gradients, [K, C, I, 3].
        gram: Of texture and gradients with each other, [K, C, 3, 3].
        own: Of light with itself, [K, C, I].
    """
    power = gram[..., :1, :1].clamp(min=FAINT)
    contrast = products[..., :1] / power
    usable = contrast.clamp(min=FAINTEST)
    shared = gram[..., 1:, :1] / power
    information = gram[..., 1:, 1:] - shared @ gram[..., :1, 1:]
    along = products[..., 1:] - products[..., :1] @ shared.mT
    # L(x + e) rises by the gradient times e: where a view rises, its patch lies towards the other side.
    moments = -along / usable
    moved = moments @ ridged(information).inverse()
    rest = own - (contrast * products[..., :1])[..., 0]
    rest = (rest / usable[..., 0].square() - (moved * moments).sum(-1)).clamp(min=0)
    return information, moments.movedim(1, 2), rest.movedim(1, 2)


def ridged(matrix: Tensor) -> Tensor:
    """A matrix that has an inverse: a direction without texture has displacement 0."""
    size = matrix.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    return matrix + (1e-9 * size + FAINT) * torch.eye(2, dtype=matrix.dtype)


# PART fitted
# Linear models fitted to what patches say, outliers left aside.
#
# Letters: `n` observation, `m` parameter, `a` component of an observation.

ROUNDS = 8
LEAST_HOLD = 0.2
OUTLYING = 2.0  # standard deviations at which an observation counts half


class Fitted(NamedTuple):
    """Parameters, and how sure they are."""

    values: Tensor
    """[M]."""
    errors: Tensor
    """Standard errors, from how observations scatter, [M]."""
    effect: float
    """Root mean square of what the model says of an observation."""
    scatter: float
    """Root of the median square of what it does not say, made as large as a standard deviation."""


def fitted(model: Tensor, seen: Tensor, information: Tensor, prior: Tensor | None = None) -> Fitted:
    """Fit by least squares, again and again, with less weight for what is far out.

    Args:
        model: What a parameter does to an observation, [N, A, M].
        seen: Observations, [N, A].
        information: Inverse covariance of each, but for a common factor, [N, A, A].
        prior: Inverse variance of each parameter about 0 before anything is seen, [M]; None: nothing is known.
    """
    trust = torch.ones(len(seen), dtype=seen.dtype)
    known, usual = torch.zeros(model.shape[-1], dtype=seen.dtype) if prior is None else prior, torch.tensor(1.0)
    for _ in range(ROUNDS):
        weighted = trust[:, None, None] * (information @ model)
        normal = torch.einsum("nai,naj->ij", weighted, model)
        normal = normal + torch.diag(usual * known + FAINT * (1 + normal.diagonal().mean()))
        values = torch.linalg.solve(normal, torch.einsum("nai,na->i", weighted, seen))
        left = seen - model @ values
        outlying = torch.einsum("na,nab,nb->n", left, information, left)
        usual = (outlying.median() / seen.shape[1]).clamp(min=FAINT)
        trust = 1 / (1 + outlying / (OUTLYING**2 * seen.shape[1] * usual))
    pulls = torch.linalg.solve(normal, torch.einsum("nai,na->in", weighted, left))
    weight = trust * information.diagonal(dim1=-2, dim2=-1).sum(-1)
    # Outliers that lose their say as they move leave less to hold the parameters than their weights promise.
    hold = _mean(2 * trust - 1, weight).clamp(min=LEAST_HOLD)
    effect = _mean((model @ values).square().mean(-1), weight).sqrt()
    return Fitted(values, pulls.square().sum(1).sqrt() / hold, float(effect), 1.48 * _median(left.norm(dim=-1), weight))


def _mean(values: Tensor, weights: Tensor) -> Tensor:
    return (values * weights).sum() / weights.sum().clamp(min=FAINT)


def _median(values: Tensor, weights: Tensor) -> float:
    """Half of the weights belong to values below."""
    ordered, order = values.sort()
    below = weights[order].cumsum(0) / weights.sum().clamp(min=FAINT)
    return float(ordered[int((below < 0.5).sum().clamp(max=len(values) - 1))])
