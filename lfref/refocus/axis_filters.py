"""Wiener filters along one axis of the picture: the factors of separable refocusing.

A filter for each view row and one for each view column make the picture, `I_s = sum_vu (g_v x h_u) * L_vu`, where g_v
acts along y and h_u along x. Along one axis, the views L_i and the photograph T are sums over disparities d and over
the frequencies q = k + m that pixels cannot tell from k. The g_i of least mean square error solve

    sum_j C_ij g_j = b_i,   C_ij = sum_dm p_d S(q) cos(2 pi d (i - j) q) + (unexplained + noise) [i = j],
    b_i = sum_dm p_d S(q) A((s - d) q) exp(-2 pi i d i q) + unexplained a_i c((s - mean) k) exp(-2 pi i s i k),

with A the transform of the aperture, the product of its weights a_i and of the cell c of a view. What no disparity
explains, such as gloss, counts as light of the photograph too, as in a sum of the views through cells: where little is
explained, the picture is that sum, and nothing is lost. Views lie symmetrically about the centre, and g of a view is
the conjugate of g of the opposite one. With g = alpha + i beta for the views on one side, all numbers are real: a view
pair p reads `2 cos(2 pi d p q)` and `2 sin(2 pi d p q)` of light at disparity d.
Letters: `n` plane, `d` disparity in pixels per view step, `i j` view, `p` view pair, by its offset from the centre, `k`
frequency in cycles per pixel, `m` fold, `q = k + m`, `s` slope, `t` tap; `N D K I T` numbers of these, `B` number of
priors. `joint_wiener` solves for the views of both axes together: for more unknowns, at more frequencies.
"""

import functools
from typing import NamedTuple

import torch
from torch import Tensor

from lfref import geometry
from lfref.functional import fourier, positive_definite
from lfref.functional.devices import on_device, on_host

DECAY = 2.5
"""Power falls with frequency to this power: 3 for edges alone, 2 for fine grain."""
OUTER = 0.01
"""Cycles per pixel below which power stays level: a picture has some hundred pixels."""
FOLDS = 1
"""Largest m along one axis: farther folds have next to no power."""
NOISE_GAIN = 4.0
"""Noise after the filters of the other axis, as a multiple of that after an even mean: they weigh views unevenly. By
trial in noise of .02 on path-traced scenes (1 and 8 lose .1 dB), and in planes of 13x13 views that are in focus (1
loses 1.6 dB)."""


class AxisSpectrum(NamedTuple):
    """What is known of light along an axis, whatever its disparity."""

    aliased: float
    """Power beyond half a cycle per pixel, as a share of what an ideal edge has there."""
    unexplained: float
    """Power that no disparity explains, as a share of all power at a frequency."""
    noise: Tensor | float = 0.0
    """Variance of the views' white noise, as a share of the picture's variance."""

    def power(self, frequencies: Tensor) -> Tensor:
        """Power spectrum S of what pixels record, at frequencies in cycles per pixel."""
        # The spectrum of pictures, averaged over the frequencies of the other axis.
        fading = (1 + (frequencies / OUTER).square()) ** (-(DECAY - 1) / 2)
        return fading * torch.sinc(frequencies).square() * torch.where(frequencies.abs() <= 0.5, 1.0, self.aliased)

    @property
    def mean_power(self) -> float:
        """Mean of S up to half a cycle per pixel: the power of white noise of the picture's variance."""
        return _mean_power(self.aliased)


@functools.cache
@on_host
def _mean_power(aliased: float) -> float:
    frequencies = (torch.arange(1024, dtype=torch.float64) + 0.5) / 2048
    return float(AxisSpectrum(aliased, 0.0).power(frequencies).mean())


class AxisEquations(NamedTuple):
    """What every disparity adds to both sides of the equations."""

    gram: Tensor
    """C of light at each disparity, [D, K, I, I]."""
    photographs: Tensor
    """b of light at each disparity, [D, K, N, I]."""
    sums: Tensor
    """b of light that no disparity explains, before the cell, [K, N, I]."""
    power: Tensor
    """S, summed over the folds, [K]."""


def readings(turns: Tensor, n_views: int) -> Tensor:
    """What the views read of light at `d q` = turns [...]: cosines and sines of pairs, the central view; [..., I]."""
    of_one_side = geometry.angular_offsets(n_views, turns.device)[(n_views + 1) // 2 :]
    angles = 2 * torch.pi * turns[..., None] * of_one_side
    central = [torch.ones_like(turns)[..., None]] if n_views % 2 else []
    return torch.cat([2 * angles.cos(), 2 * angles.sin(), *central], -1)


def counts(n_views: int, device: torch.device | None = None) -> Tensor:
    """Squared length of each reading: 2 for pairs, 1 for the central view, float64, [I]."""
    return on_device(1.0 + (torch.arange(n_views) < n_views - n_views % 2).double(), device or torch.device("cpu"))


def tables(spectrum: AxisSpectrum, disparities: Tensor, slopes: Tensor, weights: Tensor, period: int) -> AxisEquations:
    """The equations of every disparity [D] and slope [N] for symmetric weights of views [I].

    `period` is twice the number of pixels that filters reach, even.
    """
    k = torch.arange(period // 2 + 1, dtype=torch.float64, device=slopes.device) / period
    q = k[:, None] + torch.arange(-FOLDS, FOLDS + 1, device=slopes.device)
    power = spectrum.power(q)
    read = readings(disparities[:, None, None] * q, weights.shape[0])
    gram = (power[..., None] * read).transpose(2, 3) @ read
    blurs = (slopes - disparities[:, None])[..., None, None] * q
    photographs = (power * _lens(blurs, weights)).transpose(1, 2) @ read
    of_pairs, of_central = _halves(weights)
    # The plain sum reads each view at its shift, weighted.
    sums = readings(k[:, None] * slopes, weights.shape[0]) * torch.cat([of_pairs, of_pairs, of_central])
    return AxisEquations(gram, photographs, sums, power.sum(1))


def _lens(turns: Tensor, weights: Tensor) -> Tensor:
    """A at `(s - d) q` = turns [...], for symmetric weights of views [I]: their transform times that of a cell."""
    of_pairs, of_central = _halves(weights)
    even = torch.cat([of_pairs, torch.zeros_like(of_pairs), of_central])
    return readings(turns, weights.shape[0]) @ even * torch.sinc(turns)


def _halves(weights: Tensor) -> tuple[Tensor, Tensor]:
    """Symmetric weights [I] of the views on one side, and of the central one, if any."""
    n_views = weights.shape[0]
    return weights[(n_views + 1) // 2 :], weights[n_views // 2 :][: n_views % 2]


def noise_beside(disparities: Tensor, shares: Tensor, slopes: Tensor, weights: Tensor, period: int) -> Tensor:
    """Share of noise that a lens passes along the other axis over the share of light: 1 in focus, less where it blurs.

    At the frequencies of `tables`, [N, K]; `weights` are those of the views along the other axis.
    """
    device = slopes.device
    k = torch.arange(period // 2 + 1, dtype=torch.float64, device=device) / period
    other = (torch.arange(256, dtype=torch.float64, device=device) + 0.5) / 512
    lens = _lens((slopes - disparities[:, None])[..., None] * other, weights)
    left = torch.einsum("d,dny->ny", shares, lens.square())
    power = (1 + (k[:, None].square() + other.square()) / OUTER**2) ** (-DECAY / 2) * torch.sinc(other).square()
    light = left @ power.T / power.sum(1)
    return (left.mean(1, keepdim=True) / light).clamp(max=1)


def filters(
    spectrum: AxisSpectrum,
    table: AxisEquations,
    slopes: Tensor,
    shares: Tensor,
    means: Tensor,
    beside: Tensor | None = None,
) -> Tensor:
    """The filters of priors: alphas, betas, and the central view's factor, float64, [B, N, K, I].

    `shares` [B, D] are the probabilities of the disparities of the table, `means` [B] the disparities of what is
    unexplained, `beside` [N, K] is `noise_beside`; None is 1.
    """
    n_frequencies = table.power.shape[0]
    k = torch.arange(n_frequencies, dtype=torch.float64, device=slopes.device) / (2 * (n_frequencies - 1))
    gram, right = _mixed(shares, table.gram), _mixed(shares, table.photographs)
    cells = torch.sinc((slopes - means[:, None])[:, None] * k[:, None])
    right = right + (spectrum.unexplained * table.power[:, None] * cells)[..., None] * table.sums
    # Noise of the other axis' views is averaged before or after: what one axis sees of it is that much less.
    n_views = gram.shape[-1]
    diagonal = torch.diag(counts(n_views, slopes.device))
    white = spectrum.noise * NOISE_GAIN * spectrum.mean_power / n_views
    if beside is None:
        noise = spectrum.unexplained * table.power + white
        solved = positive_definite.solved(gram + noise[:, None, None] * diagonal, right.mT).mT
    else:
        noise = spectrum.unexplained * table.power[:, None] + white * beside.T
        matrices = gram[:, :, None] + noise[..., None, None] * diagonal
        solved = positive_definite.solved(matrices, right[..., None])[..., 0]
    return _with_level(solved.transpose(1, 2), table.sums[0].sum(-1))


def _mixed(shares: Tensor, table: Tensor) -> Tensor:
    """Sums over disparities, [B, ...], of a table [D, ...]."""
    return (shares @ table.flatten(1)).unflatten(1, table.shape[1:])


def _with_level(solved: Tensor, levels: Tensor) -> Tensor:
    """Filters [B, N, K, I] whose sum over the views at k = 0 is the level [N], unless that is about 0."""
    # The least squares shrink the mean brightness by the noise.
    sums = (solved[:, :, 0] * counts(solved.shape[-1], solved.device)).sum(-1)
    # Sines are 0 there.
    scale = torch.where(levels.abs() > 1e-6, levels / torch.where(sums.abs() > 1e-9, sums, 1.0), 1.0)
    return torch.cat([solved[:, :, :1] * scale[..., None, None], solved[:, :, 1:]], 2)


def kernels(filters: Tensor, centres: Tensor, n_taps: int) -> Tensor:
    """Taps of filters [..., K, I]: what view i gives to pixel x of its pixels x + centre - T / 2, ..., [..., I, T].

    Centres [..., I] are whole pixels; T is even, at most the period of the filters.
    """
    n_frequencies, n_views = filters.shape[-2:]
    period, n_pairs = 2 * (n_frequencies - 1), n_views // 2
    alpha, beta, central = filters.split([n_pairs, n_pairs, n_views % 2], -1)
    alphas = torch.cat([alpha.flip(-1), central, alpha], -1).transpose(-2, -1)
    betas = torch.cat([-beta.flip(-1), torch.zeros_like(central), beta], -1).transpose(-2, -1)
    # Turned by the centres, so that all views have the same table of taps.
    k = torch.arange(n_frequencies, device=filters.device)
    cos, sin = fourier.waves_of_period(centres.long()[..., None] * k, period)
    turned = torch.cat([alphas * cos + betas * sin, betas * cos - alphas * sin], -1)
    taps = k[:, None] * (torch.arange(n_taps, device=filters.device) - n_taps // 2)
    # Each frequency between 0 and 1/2 stands for its negative too.
    share = torch.where((k == 0) | (k == n_frequencies - 1), 1.0, 2.0)[:, None] / period
    cos, sin = fourier.waves_of_period(taps, period)
    return turned @ torch.cat([share * cos, share * sin])
