"""Joint Wiener refocusing: what a lens with the whole aperture would have photographed, by filters of all views.

Views L_i and the photograph T are sums over disparities d and over the frequencies q = k + m that pixels cannot tell
from k. The estimate sum_i g_i L_i of T of least mean square error solves

    sum_i g_i C_ij = b_j,   C_ij = sum_dm p_d S(q) exp(-2 pi i d (i - j) q) + noise,
    b_j = sum_dm p_d S(q) A((s - d) q) exp(2 pi i d j q),   A the transform of the aperture.

The prior (p, S): p_d is the probability that light is at disparity d. S is the power spectrum of natural pictures,
which falls with frequency, averaged over the area of a pixel. Power beyond half a cycle per pixel folds back, weakened
by the factor `aliased`. `unexplained` is the power that no mixture of disparities explains: occlusion, gloss, noise.
C depends on the distance of views only, and views lie symmetrically about the centre. Therefore g of a view is the
conjugate of g of the opposite view, and for sums and differences of opposite views all numbers are real.

Filters of `separable_wiener` are products of rows and columns; these are not: they tell more disparities apart, and
take longer. Views are cut into squares that overlap by twice the reach of a filter; their spectra, times the factors,
add up to those of the picture.
Letters: `n N` plane, `d` disparity in pixels per view step, `i j` view, `v u` its row and column from the centre, `k`
frequency in cycles per pixel, `m` fold, `q = k + m`, `s` slope; `B` light fields, `T` squares of a row, `J` all of
their pictures, `K` columns of frequencies.
Sources: Levin, Durand, "Linear view synthesis using a dimensionality gap light field prior", 2010; Levin, Freeman,
Durand, "Understanding Camera Trade-Offs through a Bayesian Analysis of Light Field Projections", 2008 (a prior over
slopes); Field, 1987 (power spectra of natural pictures).
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.functional import fourier, positive_definite
from lfref.functional.devices import at_most, on_device
from lfref.refocus import batches
from lfref.refocus.axis_filters import DECAY, FOLDS, OUTER

TAIL = 12
"""Pixels that filters reach beyond the shifts of the views."""
AT_ONCE = 2**24
"""Samples of all views in the squares whose spectra are held at once, 64 MB."""
MIXED_AT_ONCE = 2**20
"""Samples of the pairs that are mixed and transformed at once, 4 MB, about what caches hold; some copies are needed."""
STEP = 0.12
"""Distance of neighbouring disparities: at half of it views three steps from the centre agree to a fifth of a pixel."""
MARGIN = 0.6
"""How far beyond the map's range disparities are still thought possible, in pixels per view step."""
LEAST_NOISE = 0.003
"""Least noise of a prior by a map: wrong disparities act like noise. By trial on `sim30.WIDE` and the scene `deep` of
sim30: without it the mean of blockwise Wiener filters is .2 dB lower, with .01 `deep` is .5 dB worse."""
BROAD = 0.02
"""Probability that the map is wrong: spread evenly over its range and the margin."""


class Prior(NamedTuple):
    """What is known of a scene before its views are read."""

    disparities: Tensor
    """In pixels per view step, float64, [K]."""
    shares: Tensor
    """Probability of each, together 1, float64, [K]."""
    aliased: float = 1.0
    """Power beyond half a cycle per pixel, as a share of what an ideal edge has there."""
    unexplained: float = 0.01
    """Power that views do not share, as a share of all power at a frequency."""
    noise: Tensor | float = 0.0
    """Variance of the views' white noise, as a share of the picture's variance."""

    def power(self, rows: Tensor, columns: Tensor) -> Tensor:
        """Power spectrum S of what pixels record at vertical and horizontal frequencies, in cycles per pixel."""
        fading = (1 + (rows.square() + columns.square()) / OUTER**2) ** (-DECAY / 2)
        inside = (rows.abs() <= 0.5) & (columns.abs() <= 0.5)
        return fading * (torch.sinc(rows) * torch.sinc(columns)).square() * torch.where(inside, 1.0, self.aliased)

    @property
    def mean_power(self) -> Tensor:
        """Mean of S up to half a cycle per pixel: the power of white noise of the picture's variance."""
        # S peaks within some hundredths of a cycle.
        steps = (torch.arange(256, dtype=torch.float64, device=self.disparities.device) + 0.5) / 512
        return self.power(steps[:, None], steps).mean()


def prior_of_map(disparity: Tensor, widest: float = math.inf, noise: Tensor | float = 0.0) -> Prior:
    """The prior of a disparity map: its histogram, and a broad part for errors of the map.

    `noise` is that of `Prior`, at least `LEAST_NOISE`. `widest` is the largest distance of two disparities, which the
    host has to know where maps are on a GPU.
    """
    values = disparity.detach().double().flatten()
    first, last = ((values.amin(0) - MARGIN) / STEP).floor(), ((values.amax(0) + MARGIN) / STEP).ceil()
    n_bins = last - first + 2
    bins = torch.arange(at_most(n_bins, math.ceil((min(widest, 1e3) + 2 * MARGIN) / STEP) + 3), device=values.device)
    # Each value counts for its two neighbouring bins, by its distance, so that the mean disparity is kept.
    position = values / STEP - first
    below = position.floor()
    histogram = torch.zeros(len(bins), dtype=torch.float64, device=values.device)
    histogram.index_add_(0, below.long(), 1 - position + below)
    histogram.index_add_(0, below.long() + 1, position - below)
    shares = (1 - BROAD) * histogram / histogram.sum() + torch.where(bins < n_bins, BROAD / n_bins, 0.0)
    least = torch.as_tensor(noise, dtype=torch.float64, device=values.device).clamp(min=LEAST_NOISE)
    return Prior(STEP * (first + bins), shares, noise=least)


def opposites(n_views: int) -> tuple[int, int]:
    """Numbers of sums and of differences of opposite views: pairs have both, a central view is a sum of its own.

    The first views of the pairs, then the central one, are the first views of the grid, row by row.
    """
    return (n_views + 1) // 2, n_views // 2


def filters(
    prior: Prior, slopes: Tensor, grid: tuple[int, int], aperture: Tensor, reach: int, side: int
) -> Iterator[Tensor]:
    """Factors of the sums of opposite views, of the central view, and of the differences, which are times i.

    Plane by plane, [V U, side, side // 2 + 1] at the frequencies of `rfft2`, since all of a large grid exceed the views
    of a small one. Filters span `reach` pixels on either side; the square of `side` pixels is at best twice as large.
    """
    # A filter that reaches no farther is known by the frequencies of a square of twice its reach: only these are
    # solved for; larger squares get them by padding in pixels.
    coarse = min(side, fourier.next_fast_even(2 * reach))
    n_sums, n_pairs = opposites(grid[0] * grid[1])
    for factors in _coarse_filters(prior, slopes, grid, aperture, coarse):
        sums, differences = factors.split([n_sums, n_pairs])
        plane = _finer(torch.complex(sums, F.pad(differences, (0, 0, 0, 0, 0, n_sums - n_pairs))), side)
        yield torch.cat([plane.real, plane.imag[:n_pairs]])


def _coarse_filters(prior: Prior, slopes: Tensor, grid: tuple[int, int], aperture: Tensor, side: int) -> Tensor:
    """`filters` of all planes for the smallest square, [N, V U, side, side // 2 + 1]."""
    n_views = grid[0] * grid[1]
    half = fourier.half_frequencies(side, slopes.device)
    columns = axis(half, grid[1])
    factors = torch.stack([_factors_of_row(prior, slopes, aperture, axis(row[None], grid[0]), columns) for row in half])
    # The mean brightness passes unchanged: the least squares would shrink it by the noise.
    counts = _counts(n_views, slopes.device)
    factors[0, 0] /= (factors[0, 0, :, : len(counts)] * counts).sum(-1, keepdim=True)
    # Half a cycle per pixel is both signs of its frequency; negative frequencies mirror the positive ones.
    last = (factors[-1:] + _mirrored(factors[-1:], grid)) / 2
    factors = torch.cat([factors[:-1], last, _mirrored(factors[1:-1], grid).flip(0)])
    return factors.movedim((0, 1), (2, 3)).float().contiguous()


def _finer(spectra: Tensor, side: int) -> Tensor:
    """Spectra of real filters, [..., coarse, coarse // 2 + 1], at the frequencies of a larger square."""
    coarse = spectra.shape[-2]
    if coarse == side:
        return spectra
    centred = torch.fft.irfft2(spectra, s=(coarse, coarse)).roll((coarse // 2, coarse // 2), (-2, -1))
    for dim in (-2, -1):
        # The outermost sample is as far away on the other side: each gets half, or mirrored views would differ.
        ends = centred.narrow(dim, 0, 1) / 2
        centred = torch.cat([ends, centred.narrow(dim, 1, coarse - 1), ends], dim)
    padded = F.pad(centred, (0, side - coarse - 1, 0, side - coarse - 1))
    return torch.fft.rfft2(padded.roll((-(coarse // 2), -(coarse // 2)), (-2, -1)))


def _counts(n_views: int, device: torch.device) -> Tensor:
    """Number of views in each sum of opposite views: 2, of the central view 1."""
    n_sums, n_pairs = opposites(n_views)
    return 1.0 + (torch.arange(n_sums, device=device) < n_pairs).double()


def _mirrored(factors: Tensor, grid: tuple[int, int]) -> Tensor:
    """Factors [..., V U] at the opposite vertical frequency: those of the views mirrored in the horizontal axis.

    The mirror image (V - 1 - v, u) of a stored view is the opposite of (v, U - 1 - u), which is stored.
    """
    n_sums, n_pairs = opposites(grid[0] * grid[1])
    first = torch.arange(n_sums, device=factors.device)
    v, u = first // grid[1], first % grid[1]
    is_middle = 2 * v == grid[0] - 1
    mirror = torch.where(is_middle, first, v * grid[1] + grid[1] - 1 - u)
    sums, differences = factors.split([n_sums, n_pairs], -1)
    sign = torch.where(is_middle, 1.0, -1.0).to(factors)[:n_pairs]
    return torch.cat([sums[..., mirror], differences[..., mirror[:n_pairs]] * sign], -1)


class Axis(NamedTuple):
    """One axis of the picture, with the views' offsets along it."""

    frequencies: Tensor
    """q of each k and fold, float64, [K, 3]."""
    offsets: Tensor
    """Of the views from the centre, float64, [V]."""
    lags: Tensor
    """Distances of views, from -(V - 1) to V - 1, float64, [2 V - 1]."""

    def waves(self, disparities: Tensor, offsets: Tensor, sign: float) -> Tensor:
        """exp(sign 2 pi i d offset q), complex128, [D, K, 3, offsets]."""
        angle = sign * 2 * torch.pi * disparities[:, None, None, None] * self.frequencies[:, :, None] * offsets
        return torch.polar(torch.ones_like(angle), angle)

    def lens(self, blurs: Tensor, weights: Tensor) -> Tensor:
        """Fourier transform A of the aperture along an axis, at blurs s - d [N, D]: [N, D, K, 3].

        The weights [V] are symmetric; each view is a cell of one view step.
        """
        turn = blurs[:, :, None, None] * self.frequencies
        waves = torch.cos(2 * torch.pi * turn[..., None] * self.offsets) @ weights
        return waves * torch.sinc(turn)


def axis(frequencies: Tensor, n_views: int) -> Axis:
    """An axis of `n_views` views at these frequencies, in cycles per pixel, [K]."""
    device = frequencies.device
    lags, folds = (torch.arange(-n, n + 1, dtype=torch.float64, device=device) for n in (n_views - 1, FOLDS))
    return Axis(frequencies[:, None] + folds, geometry.angular_offsets(n_views, device), lags)


def _factors_of_row(prior: Prior, slopes: Tensor, aperture: Tensor, row: Axis, columns: Axis) -> Tensor:
    """Factors at one vertical frequency, [K, N, V U]: C and b of the least squares, then their solution."""
    disparities, shares = prior.disparities, prior.shares
    power = prior.power(row.frequencies[0][:, None], columns.frequencies[:, None])  # k, y, x
    # C, by the distance of views, [K, 2 V - 1, 2 U - 1].
    down, across = row.waves(disparities, row.lags, -1)[:, 0], columns.waves(disparities, columns.lags, -1)
    folded = torch.einsum("d,kyx,dkxu->dyku", shares + 0j, power + 0j, across)
    covariance = torch.einsum("dyku,dyv->kvu", folded, down)
    noise = prior.unexplained * power.sum((1, 2)) + prior.noise * prior.mean_power
    photographs = _photographs(power, disparities, shares, slopes, aperture, row, columns)
    return _solved(covariance, photographs, noise, (aperture.shape[0], aperture.shape[1]))


def _photographs(
    power: Tensor, disparities: Tensor, shares: Tensor, slopes: Tensor, aperture: Tensor, row: Axis, columns: Axis
) -> Tensor:
    """b: covariance of the photographs with the first view of every pair and the central one, complex, [K, N, P]."""
    n_rows = (len(row.offsets) + 1) // 2  # which hold the first views
    down = row.waves(disparities, row.offsets[:n_rows], 1)[:, 0]
    across = columns.waves(disparities, columns.offsets, 1)
    blurs, shape = slopes[:, None] - disparities, (len(slopes), *down.shape[:2], len(power))
    # Single precision: b enters linearly, so errors of 1e-6 stay as small.
    folds = (power[:, :, :, None] * shares[:, None, None, None, None] * across[:, :, None]).to(torch.complex64)
    view_rows, total = down.flatten(0, 1).mT.to(torch.complex64), power.new_zeros((), dtype=torch.complex64)
    # The aperture as few products of a row and a column, so that A is too.
    left, values, right = torch.linalg.svd(aperture)
    for v, value, u in zip(left.T, values, right, strict=False):
        if float(value) < 1e-9 * float(values[0]):
            break
        of_rows, of_columns = (on_device(part, power.device) for part in (v, value * u))
        lens, down_lens = columns.lens(blurs, of_columns).float(), row.lens(blurs, of_rows)[:, :, 0].float()
        # n d y k u, summed over the folds x
        folded = sum(folds[None, ..., x, :].movedim(3, 2) * lens[:, :, None, :, x, None] for x in range(2 * FOLDS + 1))
        folded = (folded * down_lens[:, :, :, None, None]).reshape(shape[0], shape[1] * shape[2], -1)
        total = total + view_rows @ folded
    return total.unflatten(2, (len(power), -1)).permute(2, 0, 1, 3).flatten(2)[..., : (aperture.numel() + 1) // 2]


def _solved(covariance: Tensor, photographs: Tensor, noise: Tensor, grid: tuple[int, int]) -> Tensor:
    """Real factors, [K, N, V U].

    With g = alpha + i beta for the first view of a pair, and C of views a and b a function of a - b, equation b reads
    sum_a (alpha + i beta) C(a - b) + (alpha - i beta) C(-a - b) = b_b. The central view is its own opposite: as a pair
    it is counted twice, which halves its row and its column.
    """
    first = torch.arange(opposites(grid[0] * grid[1])[0], device=covariance.device)
    v, u = first // grid[1], first % grid[1]
    minus = covariance[:, v[:, None] - v + grid[0] - 1, u[:, None] - u + grid[1] - 1]
    plus = covariance[:, v[:, None] + v, u[:, None] + u]
    crossed = -minus.imag - plus.imag
    upper, lower = torch.cat([minus.real + plus.real, crossed.mT], -1), torch.cat([crossed, minus.real - plus.real], -1)
    matrix, count = torch.cat([upper, lower], -2), _counts(grid[0] * grid[1], covariance.device) / 2
    scale = torch.cat([count, torch.ones_like(count)])
    matrix = matrix * scale[:, None] * scale + torch.diag_embed(noise[:, None] * scale)
    right = torch.cat([photographs.real, photographs.imag], -1) * scale
    kept = grid[0] * grid[1]  # a central view has no difference
    return positive_definite.solved(matrix[:, :kept, :kept], right[..., :kept].mT).mT


def refocus_jointly(field: Tensor, planes: Tensor, prior: Prior, aperture: Tensor) -> Tensor:
    """A light field [V, U, C, H, W] refocused at planes [N] by filters of all views together, [N, C, H, W].

    The aperture [V, U], of sum 1, is symmetric about both axes.
    """
    grid, size = batches.grid_and_size(field)
    # Filters are solved for in a square of twice the margin, in which FFTs are fast: what lies beyond would be cut off.
    margin = fourier.next_fast_even(2 * math.ceil(max(geometry.corner_shift(planes, grid), 2.0)) + 2 * TAIL) // 2
    side = _side(margin, size)
    slopes = on_device(planes, field.device)
    factors = filters(prior, slopes, grid, aperture, margin, side)
    table = field.new_empty(len(planes), grid[0] * grid[1], side, side // 2 + 1)
    for place, plane in zip(table, factors, strict=True):
        place.copy_(plane)
    return _filtered(field[None].flatten(1, 2), table, side, margin)[0]


def _side(margin: int, size: tuple[int, int]) -> int:
    """Side of the squares that take the least work: filters for one of them (about 3 FFTs), and FFTs for all."""
    sides = (96, 128, 160, 192, 256, 320, 384, 512, fourier.next_fast_even(max(size) + 2 * margin))

    def work(side: int) -> float:
        n_squares = math.prod(math.ceil(length / (side - 2 * margin)) for length in size)
        return (3 + n_squares) * side**2

    return min((side for side in sides if side > 2 * margin + 8), key=work)


def _filtered(views: Tensor, table: Tensor, side: int, margin: int) -> Tensor:
    """Sums [B, N, C, H, W] of views [B, V U, C, H, W], filtered in squares by the `filters` of all planes.

    Of each square of `side` pixels, `margin` pixels at each border are read but not written.
    """
    size = views.shape[-2:]
    step = side - 2 * margin
    counts = [-(-length // step) for length in size]
    n_squares = max(1, AT_ONCE // (math.prod(views.shape[:3]) * side**2))
    stack = views.new_empty(len(views), len(table), views.shape[2], *size)
    # Some squares of a row at a time: the spectra of all would take many times the memory of the views.
    for row in range(counts[0]):
        for first in range(0, counts[1], n_squares):
            last = min(first + n_squares, counts[1])
            left = first * step - margin
            spectra = _spectra(views, (row * step - margin, left), last - first, side, step)
            total = _mixed(spectra.flatten(1, 3), table, opposites(views.shape[1])[0])
            total = total.unflatten(1, spectra.shape[1:4]).transpose(0, 1)
            inner = torch.fft.irfft2(total, s=(side, side))[..., margin : side - margin, margin : side - margin]
            place = stack[..., row * step : (row + 1) * step, first * step : last * step]
            # The last squares reach beyond the picture.
            place.copy_(inner.movedim(-3, -2).flatten(-2)[..., : place.shape[-2], : place.shape[-1]])
    return stack


def _spectra(views: Tensor, corner: tuple[int, int], n_squares: int, side: int, step: int) -> Tensor:
    """Spectra of sums of opposite views, of the central view, and of differences, [V U, B, C, T, side, side // 2 + 1].

    T squares lie side by side, `step` pixels apart, the first pixel of the first one at `corner` of the views
    [B, V U, C, H, W]; beyond the views, the outermost pixels are repeated.
    """
    n_fields, n_views, n_channels = views.shape[:3]
    shape = (n_views, n_fields, n_channels, n_squares, side, side // 2 + 1)
    spectra = views.new_empty(shape, dtype=fourier.complex_dtype(views.dtype))
    (top, left), width = corner, (n_squares - 1) * step + side
    beyond = (max(-left, 0), max(left + width - views.shape[-1], 0), max(-top, 0), max(top + side - views.shape[-2], 0))
    within = views[..., max(top, 0) : top + side, max(left, 0) : left + width]

    def transform(mixed: Tensor, first: int) -> None:
        padded = F.pad(mixed.flatten(0, 2), beyond, mode="replicate").unflatten(0, mixed.shape[:3])
        squares = padded.unfold(-1, side, step).movedim(-2, -3)
        spectra[first : first + mixed.shape[1]] = torch.fft.rfft2(squares).transpose(0, 1)

    n_sums, n_pairs = opposites(n_views)
    n_at_once = max(1, MIXED_AT_ONCE // (n_fields * n_channels * side * width))
    for first in range(0, n_pairs, n_at_once):
        last = min(first + n_at_once, n_pairs)
        one, other = within[:, first:last], within[:, n_views - last : n_views - first].flip(1)
        transform(one + other, first)
        transform(one - other, n_sums + first)
    if n_pairs < n_sums:
        transform(within[:, n_pairs:n_sums], n_pairs)
    return spectra


def _mixed(spectra: Tensor, table: Tensor, n_sums: int) -> Tensor:
    """Spectra [V U, J, side, K] times factors [N, V U, side, K], added up, [N, J, side, K]; times i after `n_sums`."""
    parts, stack = torch.view_as_real(spectra).movedim(-1, 1).contiguous(), []
    for factors in table:
        sums, differences = torch.zeros_like(parts[0]), torch.zeros_like(parts[0])
        for p, (part, factor) in enumerate(zip(parts, factors, strict=True)):
            (sums if p < n_sums else differences).addcmul_(part, factor)
        stack.append(torch.complex(sums[0] - differences[1], sums[1] + differences[0]))
    return torch.stack(stack)
