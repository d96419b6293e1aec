"""The filters of Wiener refocusing: a factor for every plane, view and frequency.

Views L_i and the photograph T are sums over disparities d and over the frequencies q = k + m that pixels cannot tell
from k. The estimate sum_i g_i L_i of T of least mean square error solves

    sum_i g_i C_ij = b_j,   C_ij = sum_dm p_d S(q) exp(-2 pi i d (i - j) q) + noise,
    b_j = sum_dm p_d S(q) A((s - d) q) exp(2 pi i d j q),   A the transform of the aperture.

C depends on the distance of views only, and views lie symmetrically about the centre, so that g of a view is the
conjugate of g of the view opposite. In terms of the sums and differences of opposite views all of it is real.
Letters: `n` plane, `d` disparity, `i j` view, `v u` its row and column from the centre, `k` frequency in cycles per
pixel, `m` fold, `q = k + m`, `s` slope.
"""

import functools
import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.errors import InputError
from lfref.functional import fourier

# PART prior
# What is known of a scene before its views are read: which disparities it has, and how fast its detail fades.
#
# A scene is a mixture: light at disparity d, with probability p(d), whose power spectrum falls as natural pictures' do,
# averaged over the area of a pixel. Pixels sample it, so that what lies beyond half a cycle a pixel folds back; how
# much
# of it there is, is `aliased`. What no mixture of disparities explains (occlusion, gloss) counts as `unexplained`.
# Letters: `d` disparity in pixels per view step, `k` frequency in cycles per pixel.
# Source: Levin, Freeman, Durand, "Understanding Camera Trade-Offs through a Bayesian Analysis of Light Field
# Projections", 2008 (a prior over slopes); Field, 1987 (power spectra of natural pictures).

STEP = 0.12
"""Distance of neighbouring disparities: at half of it views three steps from the centre agree to a fifth of a pixel."""
MARGIN = 0.6
"""How far beyond those that were found disparities are still thought possible, in pixels per view step."""
BROAD = 0.05
"""Probability of a disparity that was not found, anywhere within the margin."""
DECAY = 2.5
"""Power falls with frequency to this power; edges alone would give 3, fine grain 2."""
OUTER = 0.01
"""Cycles per pixel below which power stays level: a picture has some hundred pixels."""


class Prior(NamedTuple):
    """Light of several disparities; hashable, so that filters can be kept."""

    disparities: tuple[float, ...]
    """In pixels per view step, [K]."""
    shares: tuple[float, ...]
    """Probability of each, together 1, [K]."""
    aliased: float = 0.1
    """Power beyond half a cycle a pixel, as a share of what an ideal edge has there."""
    unexplained: float = 0.01
    """Power that views do not share, as a share of all power at a frequency; noise too."""

    def power(self, rows: Tensor, columns: Tensor) -> Tensor:
        """Power spectrum of what pixels record.

        Args:
            rows: Vertical frequency in cycles per pixel, float64.
            columns: Horizontal frequency, of a shape that goes with it.
        """
        fading = (1 + (rows.square() + columns.square()) / OUTER**2) ** (-DECAY / 2)
        inside = (rows.abs() <= 0.5) & (columns.abs() <= 0.5)
        return fading * (torch.sinc(rows) * torch.sinc(columns)).square() * torch.where(inside, 1.0, self.aliased)


def found_in(disparity: Tensor, confidence: Tensor | None = None) -> Prior:
    """The prior that a map of disparities gives: its histogram, its rare values lifted, and some doubt all around.

    Args:
        disparity: Of all pixels, in pixels per view step, finite, any shape.
        confidence: How much each counts, >= 0, of the same shape; None counts all alike.

    Raises:
        InputError: A disparity that is not finite.
    """
    values = disparity.detach().double().cpu().flatten()
    if not bool(values.isfinite().all()) or values.numel() == 0:
        raise InputError("disparities must be finite and at least one", got="NaN, infinity or none")
    counts = torch.ones_like(values) if confidence is None else confidence.detach().double().cpu().flatten()
    first = math.floor((float(values.min()) - MARGIN) / STEP)
    last = math.ceil((float(values.max()) + MARGIN) / STEP)
    histogram = torch.zeros(last - first + 2, dtype=torch.float64)
    place = values / STEP - first
    below = place.floor().long()
    histogram.index_add_(0, below, counts * (1 - place + below))
    histogram.index_add_(0, below + 1, counts * (place - below))
    # Rare disparities are edges more often than not, where the estimate has to be good.
    lifted = histogram.sqrt()
    shares = (1 - BROAD) * lifted / lifted.sum() + BROAD / len(lifted)
    return Prior(tuple((STEP * (first + i)) for i in range(len(shares))), tuple(shares.tolist()))


def between(first: float, last: float) -> Prior:
    """The prior of a scene of which no more is known than its nearest and farthest disparity.

    Args:
        first: In pixels per view step.
        last: Likewise.
    """
    return found_in(torch.arange(min(first, last), max(first, last) + STEP / 2, STEP, dtype=torch.float64))


FOLDS = torch.tensor([-1.0, 0.0, 1.0], dtype=torch.float64)


class Pairs(NamedTuple):
    """Views by their opposites: P pairs, then the central view, if there is one."""

    first: Tensor
    """Number of the first view of each pair and of the central one, row by row, [P + 0 or 1]."""
    n_pairs: int
    """P."""

    def mixed(self, views: Tensor) -> Tensor:
        """Sums of opposite views, the central view, and differences of opposite views.

        Args:
            views: Row by row, [..., V U, C, H, W].
        """
        opposite = views.flip(-4)
        pairs = views.narrow(-4, 0, self.n_pairs), opposite.narrow(-4, 0, self.n_pairs)
        centre = views.narrow(-4, self.n_pairs, len(self.first) - self.n_pairs)
        return torch.cat([pairs[0] + pairs[1], centre, pairs[0] - pairs[1]], -4)


def opposites(grid: tuple[int, int]) -> Pairs:
    """The pairs of a grid (V, U)."""
    n_views = grid[0] * grid[1]
    return Pairs(torch.arange((n_views + 1) // 2), n_views // 2)


class Axis(NamedTuple):
    """One axis of the picture, with the views' offsets along it."""

    frequencies: Tensor
    """q of each k and fold, float64, [K, 3]."""
    offsets: Tensor
    """Of the views from the centre, float64, [V]."""
    lags: Tensor
    """Distances of views, from -(V - 1) to V - 1, float64, [2 V - 1]."""

    def waves(self, disparities: Tensor, places: Tensor, sign: float) -> Tensor:
        """exp(sign 2 pi i d place q), complex128, [D, K, 3, places]."""
        angle = sign * 2 * torch.pi * disparities[:, None, None, None] * self.frequencies[:, :, None] * places
        return torch.polar(torch.ones_like(angle), angle)

    def lens(self, blurs: Tensor, weights: Tensor) -> Tensor:
        """Transform of an aperture's weights along the axis, each an area of one view step, real, [N, D, K, 3].

        Args:
            blurs: s - d, [N, D].
            weights: Of the views, alike on both sides of the centre, [V].
        """
        turn = blurs[:, :, None, None] * self.frequencies
        waves = torch.cos(2 * torch.pi * turn[..., None] * self.offsets) @ weights
        return waves * torch.sinc(turn)


def axis(frequencies: Tensor, n_views: int) -> Axis:
    """An axis of `n_views` views at these frequencies, in cycles per pixel, [K]."""
    lags = torch.arange(1 - n_views, n_views, dtype=torch.float64)
    return Axis(frequencies[:, None] + FOLDS, geometry.angular_offsets(n_views), lags)


@functools.lru_cache(maxsize=8)
def filters(
    prior: Prior,
    slopes: tuple[float, ...],
    grid: tuple[int, int],
    aperture: tuple[tuple[float, ...], ...],
    reach: int,
    side: int,
) -> Tensor:
    """Factors of what `Pairs.mixed` makes of the views; those of differences are times i.

    Args:
        prior: What the scene is like.
        slopes: In pixels per view step, [N].
        grid: View rows and columns (V, U).
        aperture: Weight of each view, together 1, alike on both sides of both axes, [V, U].
        reach: Pixels that a filter spans on either side.
        side: Of the square that is transformed, in pixels, even, at best twice the reach.

    Returns:
        Real, float32, at the frequencies of `rfft2`, [N, V U, side, side // 2 + 1].
    """
    both = opposites(grid)
    # So many frequencies say all there is to say of filters that reach no farther.
    coarse = min(side, fourier.next_fast_even(2 * reach))
    half = fourier.half_frequencies(coarse)
    task = _Task(prior, torch.tensor(slopes, dtype=torch.float64), torch.tensor(aperture, dtype=torch.float64))
    columns = axis(half, grid[1])
    found = torch.stack([task.row(axis(row[None], grid[0]), columns) for row in half])
    found[0, 0] /= (found[0, 0, :, : len(both.first)] * _counts(grid)).sum(-1, keepdim=True)
    # Half a cycle a pixel is both signs of its frequency.
    last = (found[-1:] + _mirrored(found[-1:], grid)) / 2
    found = torch.cat([found[:-1], last, _mirrored(found[1:-1], grid).flip(0)]).movedim((0, 1), (2, 3)).float()
    sums, differences = found.split([len(both.first), both.n_pairs], 1)
    first = _finer(torch.complex(sums, F.pad(differences, (0, 0, 0, 0, 0, len(both.first) - both.n_pairs))), side)
    return torch.cat([first.real, first.imag[:, : both.n_pairs]], 1)


def _finer(spectra: Tensor, side: int) -> Tensor:
    """Spectra of real filters, [..., coarse, coarse // 2 + 1], at the frequencies of a larger square."""
    coarse = spectra.shape[-2]
    if coarse == side:
        return spectra
    centred = torch.fft.irfft2(spectra, s=(coarse, coarse)).roll((coarse // 2, coarse // 2), (-2, -1))
    for axis in (-2, -1):
        # The outermost sample is as far away on the other side: each has half, or mirrored views would differ.
        ends = centred.narrow(axis, 0, 1) / 2
        centred = torch.cat([ends, centred.narrow(axis, 1, coarse - 1), ends], axis)
    padded = F.pad(centred, (0, side - coarse - 1, 0, side - coarse - 1)).roll(
        (-(coarse // 2), -(coarse // 2)), (-2, -1)
    )
    return torch.fft.rfft2(padded)


def _counts(grid: tuple[int, int]) -> Tensor:
    """How many views stand behind each sum of opposite views."""
    both = opposites(grid)
    return torch.where(torch.arange(len(both.first)) < both.n_pairs, 2.0, 1.0).double()


def _mirrored(factors: Tensor, grid: tuple[int, int]) -> Tensor:
    """Factors [..., V U] at the opposite vertical frequency: those of the views mirrored in the horizontal axis.

    The mirror image of a first view is the opposite of the one in its own row mirrored in the vertical axis, but in
    the middle row, which the mirror leaves.
    """
    both = opposites(grid)
    v, u = both.first // grid[1], both.first % grid[1]
    is_middle = 2 * v == grid[0] - 1
    place = torch.where(is_middle, both.first, v * grid[1] + grid[1] - 1 - u)
    sums, differences = factors.split([len(place), both.n_pairs], -1)
    sign = torch.where(is_middle, 1.0, -1.0).to(factors)[: both.n_pairs]
    return torch.cat([sums[..., place], differences[..., place[: both.n_pairs]] * sign], -1)


class _Task(NamedTuple):
    """What filters are made for."""

    prior: Prior
    slopes: Tensor
    """[N]."""
    aperture: Tensor
    """[V, U]."""

    def row(self, row: Axis, columns: Axis) -> Tensor:
        """Factors at one vertical frequency, [K, N, V U]."""
        known = torch.tensor([self.prior.disparities, self.prior.shares], dtype=torch.float64)
        power = self.prior.power(row.frequencies[0][:, None], columns.frequencies[:, None])  # k, y, x
        covariance = _covariance(power, known, row, columns)
        noise = self.prior.unexplained * power.sum((1, 2))
        grid = (self.aperture.shape[0], self.aperture.shape[1])
        return _solved(covariance, self.wanted(power, known, row, columns), noise, grid)

    def wanted(self, power: Tensor, known: Tensor, row: Axis, columns: Axis) -> Tensor:
        """Covariance of the photographs with the first view of every pair and the central one, complex, [K, N, P]."""
        disparities, shares = known
        n_first = (self.aperture.numel() + 1) // 2
        n_rows = (len(row.offsets) + 1) // 2  # which hold them
        down = row.waves(disparities, row.offsets[:n_rows], 1)[:, 0]
        across = columns.waves(disparities, columns.offsets, 1)
        blurs, shape = self.slopes[:, None] - disparities, (len(self.slopes), *down.shape[:2], len(power))
        # Single precision: what is wanted enters linearly, and errors of 1e-6 stay as small.
        folds = (power[:, :, :, None] * shares[:, None, None, None, None] * across[:, :, None]).to(torch.complex64)
        view_rows, total = down.flatten(0, 1).mT.to(torch.complex64), torch.zeros((), dtype=torch.complex64)
        left, values, right = torch.linalg.svd(self.aperture)
        for v, value, u in zip(left.T, values, right, strict=False):
            if float(value) < 1e-9 * float(values[0]):
                break
            lens, down_lens = (columns.lens(blurs, u) * value).float(), row.lens(blurs, v)[:, :, 0].float()
            # n d y k u, summed over the folds x
            folded = sum(folds[None, ..., x, :].movedim(3, 2) * lens[:, :, None, :, x, None] for x in range(len(FOLDS)))
            folded = (folded * down_lens[:, :, :, None, None]).reshape(shape[0], shape[1] * shape[2], -1)
            total = total + view_rows @ folded
        return total.unflatten(2, (len(power), -1)).permute(2, 0, 1, 3).flatten(2)[..., :n_first]


def _covariance(power: Tensor, known: Tensor, row: Axis, columns: Axis) -> Tensor:
    """Of views by their distance, complex, [K, 2 V - 1, 2 U - 1]."""
    disparities, shares = known
    down, across = row.waves(disparities, row.lags, -1)[:, 0], columns.waves(disparities, columns.lags, -1)
    folded = torch.einsum("d,kyx,dkxu->dyku", shares + 0j, power + 0j, across)
    return torch.einsum("dyku,dyv->kvu", folded, down)


def _solved(covariance: Tensor, wanted: Tensor, noise: Tensor, grid: tuple[int, int]) -> Tensor:
    """Real factors, [K, N, V U].

    With g = alpha + i beta for the first view of a pair, and C of views a and b a function of a - b, equation b reads
    sum_a (alpha + i beta) C(a - b) + (alpha - i beta) C(-a - b) = b_b. The central view is its own opposite: as a pair
    it is counted twice, which halves its row and its column.
    """
    both = opposites(grid)
    v, u = both.first // grid[1], both.first % grid[1]
    minus = covariance[:, v[:, None] - v + grid[0] - 1, u[:, None] - u + grid[1] - 1]
    plus = covariance[:, v[:, None] + v, u[:, None] + u]
    crossed = -minus.imag - plus.imag
    upper, lower = torch.cat([minus.real + plus.real, crossed.mT], -1), torch.cat([crossed, minus.real - plus.real], -1)
    matrix, count = torch.cat([upper, lower], -2), _counts(grid) / 2
    scale = torch.cat([count, torch.ones_like(count)])
    matrix = matrix * scale[:, None] * scale + torch.diag_embed(noise[:, None] * scale)
    right = torch.cat([wanted.real, wanted.imag], -1) * scale
    kept = grid[0] * grid[1]  # a central view has no difference
    factor = torch.linalg.cholesky(matrix[:, :kept, :kept])
    return torch.cholesky_solve(right[..., :kept].mT, factor).mT
