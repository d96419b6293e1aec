"""Separable Wiener refocusing as a graph: energies, noise, filters and sums in one file.

It computes what `lfref.separable_wiener` computes, by its own functions where they are plain operations. Runtimes have
no solvers and no branches: positive definite matrices are inverted by sweeps over their rows, layers that are not
tried have shares of 0, and masks select the blocks of a level of light. The reach of the filters is a length that data
decide. Small systems are float64.
Where views move so far that gradients fail, about 3 pixels per view step, the method searches all slopes, and the
graph does not.
Letters: `N` planes, `K` layers, `F` frequencies that are sampled, `M` blocks, `I` views along an axis, `T` taps,
`C H W` channel, pixel row and column, `v u` view row and column.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn

from lfref.export.sums import Aperture, CubicSum, filter_and_sum, gathered, number, snapped, wrapped
from lfref.functional import noise_line
from lfref.functional.neighbours import box_max
from lfref.refocus import axis_filters, batches, separable_wiener
from lfref.refocus.fourier import disparity_layers
from lfref.refocus.fourier.disparity_layers import Energies

BEYOND = 3e38
"""Stands for infinity, which files may not hold."""


class SeparableWiener(nn.Module):
    """Light [V, U, C, H, W] and slopes [N] -> stack [N, C, H, W]; see `lfref.separable_wiener`.

    Args:
        aperture: Of the views, symmetric about both axes.
    """

    def __init__(self, aperture: Aperture) -> None:
        super().__init__()
        self.terms = separable_wiener.products(batches.symmetric_weights(aperture.weights, aperture.grid))
        self.level = float(sum(term.rows.sum() * term.columns.sum() for term in self.terms))
        self.energies, self.noise = LayerEnergies(aperture), NoiseShare(aperture)
        self.sums = CubicSum(aperture)

    def forward(self, light: Tensor, slopes: Tensor) -> Tensor:
        """Refocus."""
        energies, width = self.energies(light)
        prior = separable_wiener.finer(energies)
        spectrum = separable_wiener.SPECTRUM._replace(noise=self.noise(light, energies.noise))
        planes = slopes.double()
        mean_disparity = prior.shares @ prior.disparities
        # In the spectra, the mean would be by far the largest number, and round as such.
        mean = light.mean((0, 1, 3, 4), keepdim=True)
        stack = self.level * mean[0]
        reaches = [_reach(slopes, n_views) for n_views in light.shape[:2]]
        longer = _continued(_continued(light - mean, reaches[0], 3), reaches[1], 4)
        for term in self.terms:
            taps = []
            for weights, reach in zip(term, reaches, strict=True):
                table = axis_filters.tables(spectrum, prior.disparities, planes, weights, 2 * reach)
                filters = axis_filters.filters(
                    spectrum, table, planes, prior.shares[None], mean_disparity[None], solve=by_sweeps
                )[0]
                centres = torch.zeros(weights.shape[0], dtype=torch.int64)
                taps.append(axis_filters.kernels(filters, centres, 2 * reach).float())
            factors, down = _factors(taps[1], longer.shape[4]), _rows(taps[0], light.shape[3])
            sums = filter_and_sum(longer, factors, down)
            stack = stack + sums.narrow(3, reaches[1], light.shape[4])
        return self._bounded(stack, light, slopes, width.float())

    def _bounded(self, stack: Tensor, light: Tensor, slopes: Tensor, width: Tensor) -> Tensor:
        """As `disparity_layers.bounded_by_views`, for disparities over a range of this width."""
        (near, far), (most, least) = disparity_layers.RANGES, disparity_layers.SHARES_OF_SPREAD
        share = most + ((width - near) / (far - near)).clamp(min=0).clamp(max=1) * (least - most)
        # Graphs have no branches. Where nothing is bounded, the sums are computed for one plane, and not used.
        n_planes = slopes.shape[0]
        n_bounded = _length(torch.where(width > disparity_layers.CONFUSABLE, number(n_planes), number(1)))
        planes = slopes.narrow(0, 0, n_bounded)
        whole, covered = self.sums(torch.cat([light, light.square()], 2), planes)
        n_channels = light.shape[2]
        points, squares = whole.narrow(1, 0, n_channels), whole.narrow(1, n_channels, n_channels)
        spread = (squares - points.square()).clamp(min=0).sqrt().amax(1, keepdim=True)
        is_free = (covered <= 0.999) | (width <= disparity_layers.CONFUSABLE)
        bound = torch.where(is_free, torch.full((), BEYOND), share * box_max(spread, 3))
        first = stack.narrow(0, 0, n_bounded)
        inside = torch.maximum(torch.minimum(first, points + bound), points - bound)
        return torch.cat([inside, stack.narrow(0, n_bounded, n_planes - n_bounded)])


class Sample(NamedTuple):
    """Views at some frequencies, as `disparity_layers` samples them."""

    real: Tensor
    """Each frequency of energy 1, each view times the root of its weight, [F, V U]."""
    imaginary: Tensor
    turns: Tensor
    """kx (u - u0) + ky (v - v0), [F, V U]."""
    variance: Tensor
    """Variance of white noise that has all the energy of a frequency, [F]."""
    counts: Tensor
    """1, or 0 where an earlier frequency is the same, [F]."""


class LayerEnergies(nn.Module):
    """As `disparity_layers.estimate_energies`: light -> energies, and the width of the range of disparities.

    There are as many layers as the widest range needs; those beyond the range have no energy.
    """

    roots: Tensor
    rows: Tensor
    columns: Tensor
    tried: Tensor

    def __init__(self, aperture: Aperture) -> None:
        super().__init__()
        weights, grid = aperture.weights.double(), aperture.grid
        self.grid, self.n_views = grid, float(1 / weights.square().sum())
        self.register_buffer("roots", weights.sqrt().flatten())
        self.register_buffer("rows", aperture.rows.double()[:, None].expand(grid).flatten())
        self.register_buffer("columns", aperture.columns.double().expand(grid).flatten())
        side = round(disparity_layers.REACH / disparity_layers.STEP)
        self.register_buffer("tried", torch.arange(-side, side + 1, dtype=torch.float64) * disparity_layers.STEP)
        widest = torch.tensor(2 * disparity_layers.REACH + disparity_layers.STEP)
        self.n_layers = max(separable_wiener.N_LAYERS, min(int(self._needed(widest)), disparity_layers.MOST_LAYERS))

    def forward(self, light: Tensor) -> tuple[Energies, Tensor]:
        """Estimate the energies."""
        sample = self._sampled(light)
        low, high = self._held(sample, light)
        n_needed = self._needed(high - low).clamp(min=separable_wiener.N_LAYERS).clamp(max=self.n_layers)
        place = torch.arange(self.n_layers, dtype=torch.float64)
        disparities = low + (high - low) / (n_needed - 1) * place
        return self._maximised(sample, disparities, place < n_needed), high - low

    def _needed(self, width: Tensor) -> Tensor:
        """Number of layers over a range of this width."""
        return 1 + (width * ((max(self.grid) - 1) / 2 / disparity_layers.SPACING)).ceil()

    def _sampled(self, light: Tensor) -> Sample:
        height, width = light.shape[3:]
        size = number(height), number(width)
        y, x = disparity_layers.sampled_bins(*(length.double() for length in size))
        code = y * size[1] + x
        place = torch.arange(code.shape[0])
        is_earlier = (code[:, None] == code) & (place[:, None] > place)
        counts = (is_earlier.long().sum(1) == 0).double()
        # All frequencies of rows first. The mean is at none of them, and would round as the largest number.
        grey = light.sum(2).reshape(-1, height, width)
        (cos_x, sin_x), (cos_y, sin_y) = (
            _turned(wrapped(torch.arange(length)[:, None] * at, length) / number(length))
            for length, at in ((width, x), (height, y))
        )
        real, imaginary = ((grey - grey.mean()) @ torch.cat([cos_x, -sin_x], 1)).split(code.shape[0], 2)
        spectra = [(real * cos_y + imaginary * sin_y).sum(1), (imaginary * cos_y - real * sin_y).sum(1)]
        weighted = torch.stack(spectra).double().transpose(1, 2) * self.roots
        energy = weighted.square().sum((0, 2))
        real, imaginary = weighted / energy.sqrt().clamp(min=torch.finfo(torch.float32).tiny)[:, None]
        ky, kx = (at.double() / length for at, length in ((y, size[0]), (x, size[1])))
        turns = ky[:, None] * self.rows + kx[:, None] * self.columns
        n_samples = light.shape[2] * size[0] * size[1]
        return Sample(real, imaginary, turns, energy / n_samples, counts)

    def _held(self, sample: Sample, light: Tensor) -> tuple[Tensor, Tensor]:
        """As `disparity_layers`: ends of the layers that hold light."""
        step = disparity_layers.STEP
        sides = [
            number(n).double() / max(n_views - 1, 1) for n, n_views in zip(light.shape[3:], self.grid, strict=True)
        ]
        limit = torch.minimum(*sides) - step
        n_side = (limit.clamp(max=disparity_layers.REACH) / step).ceil().clamp(min=0)
        is_tried = self.tried.abs() <= n_side * step
        shares = self._maximised(sample, self.tried, is_tried).shares
        quartile = _quantile(shares, is_tried, 0.25)
        least = (disparity_layers.OVER_NOISE * quartile).clamp(min=disparity_layers.LEAST_SHARE)
        is_held = is_tried & (shares >= torch.minimum(least, shares.amax(0)))
        low = torch.where(is_held, self.tried, torch.full((), BEYOND)).amin(0) - step / 2
        return low, torch.where(is_held, self.tried, torch.full((), -BEYOND)).amax(0) + step / 2

    def _maximised(self, sample: Sample, disparities: Tensor, is_tried: Tensor) -> Energies:
        """As `disparity_layers`: energies of layers [K] under which the sample is most likely."""
        cos, sin = (part * self.roots[:, None] for part in _turned(sample.turns[..., None] * disparities))
        model, conjugate = torch.cat([cos, sin], 1), torch.cat([cos, -sin], 1)  # [F, 2 V U, K]
        # Apertures are symmetric, so that the products of layers are real.
        gram = model.transpose(1, 2) @ model
        views, swapped = (
            torch.cat(parts, 1)[..., None]
            for parts in ((sample.real, sample.imaginary), (sample.imaginary, sample.real))
        )
        explained = torch.cat([conjugate.transpose(1, 2) @ views, model.transpose(1, 2) @ swapped], 2)  # [F, K, 2]
        energy = views.square().sum((1, 2))
        shares, noise = is_tried.double() / is_tried.double().sum(), torch.full((), 0.01, dtype=torch.float64)
        counts, eye = sample.counts / sample.counts.sum(), torch.eye(disparities.shape[0], dtype=torch.float64)
        rest = freedom = energy
        for _ in range(disparity_layers.N_STEPS):
            root = shares.sqrt()
            inverse = inverted(root[:, None] * gram * root + noise * eye)
            layers = root[:, None] * (inverse @ (root[:, None] * explained))
            variance = noise * (inverse * eye).sum(2)
            rest = energy + (layers * (gram @ layers - 2 * explained)).sum((1, 2))
            freedom = self.n_views - (1 - variance).sum(1)
            shares = counts @ (layers.square().sum(2) + shares * variance)
            noise = ((counts * rest).sum() / (counts * freedom).sum()).clamp(min=1e-6)
        left = rest.clamp(min=0) / freedom * self.n_views * sample.variance
        quiet = _quantile(left, sample.counts > 0, disparity_layers.QUIET) / disparity_layers.QUIET_VARIANCE
        return Energies(disparities, shares / shares.sum(), quiet)  # type: ignore[arg-type]


class NoiseShare(nn.Module):
    """As `separable_wiener.noise_share`: light and the noise between views -> noise as a share of the variance."""

    def __init__(self, aperture: Aperture) -> None:
        super().__init__()
        self.n_open = int((aperture.weights > 0).sum())

    def forward(self, light: Tensor, between: Tensor) -> Tensor:
        """Measure the noise."""
        if self.n_open < 2:
            return torch.zeros((), dtype=torch.float64)
        rows, columns = (((n_views - 1) // 2, 1 + (n_views - 1) % 2) for n_views in light.shape[:2])
        central = light.narrow(0, *rows).narrow(1, *columns).mean((0, 1, 2))
        n_channels, n_pixels = light.shape[2], number(light.shape[3]) * number(light.shape[4])
        variance = (central - central.mean()).square().sum() / (n_pixels - 1)
        shot, read = _noise_line(light)
        noise = torch.minimum(between, (shot * central.mean() + read).double())
        signal = torch.maximum((variance - noise / n_channels).clamp(min=torch.finfo(torch.float32).tiny), noise)
        return noise / signal


def _noise_line(light: Tensor) -> tuple[Tensor, Tensor]:
    """As `noise_line.measure`: variance per unit of light, and in the dark."""
    n_rows, n_columns, n_channels, height, width = light.shape
    n_samples = n_channels * number(height) * number(width)
    count = torch.div(torch.full((), noise_line.SAMPLES), n_samples, rounding_mode="floor").clamp(min=1)
    count = count.clamp(max=n_rows * n_columns)
    place = (2 * torch.arange(_length(count)) + 1) * ((n_rows * n_columns - 1) / 2) / count
    views = light.reshape(n_rows * n_columns, n_channels, height, width).index_select(0, place.round().long())
    levels, power = noise_line.blocks(views.reshape(-1, height, width))
    is_usable = (levels > 0) & (levels < noise_line.BRIGHTEST)
    n_usable = is_usable.sum()
    order = torch.where(is_usable, levels, torch.full((), BEYOND)).sort().indices
    levels, power = levels.index_select(0, order), power.index_select(0, order).transpose(0, 1)
    n_bins = torch.div(n_usable, noise_line.LEAST_BLOCKS, rounding_mode="floor").clamp(min=1).clamp(max=noise_line.BINS)
    size, n_larger = torch.div(n_usable, n_bins, rounding_mode="floor"), n_usable.remainder(n_bins)
    rank, nothing = torch.arange(levels.shape[0]), torch.full((), BEYOND)
    lights, variances, exists = [], [], []
    for level in range(noise_line.BINS):
        first = level * size + n_larger.clamp(max=level)
        n_blocks = size + (n_larger > level).long()
        is_inside = (rank >= first) & (rank < first + n_blocks)
        by_frequency = _lowest(torch.where(is_inside, power, nothing), noise_line.QUIET_BLOCKS, n_blocks)
        quiet = _lowest(by_frequency, noise_line.QUIET_FREQUENCIES, number(by_frequency.shape[0]))
        lights.append((levels * is_inside).sum() / n_blocks.clamp(min=1))
        variances.append(quiet / noise_line.QUIET_VARIANCE)
        exists.append((n_bins > level) & (n_blocks > 0))
    exist = torch.stack(exists)
    x, y = (torch.where(exist, torch.stack(each), torch.zeros(())).double() for each in (lights, variances))
    return noise_line.fitted_line(x, y, exist.double())


def _lowest(values: Tensor, share: float, count: Tensor) -> Tensor:
    """As `noise_line`, along the last axis, where only `count` of the values are finite: [...] of [..., M]."""
    place = (share * count).round().long().clamp(min=1) - 1
    return values.sort().values.index_select(-1, place[None]).squeeze(-1)


def inverted(matrices: Tensor) -> Tensor:
    """Inverses of positive definite matrices [..., n, n], by a sweep over each row."""
    n = matrices.shape[-1]
    eye = torch.eye(n, dtype=matrices.dtype)
    for row in range(n):
        # Each sweep is a product of a column and itself, but for 2 on the diagonal, which comes last.
        column = matrices.narrow(-1, row, 1)
        shifted = column - eye[:, row : row + 1]
        matrices = matrices - shifted / column.narrow(-2, row, 1) * shifted.transpose(-2, -1)
    return 2 * eye - matrices


def by_sweeps(matrices: Tensor, right: Tensor) -> Tensor:
    """As `axis_filters.by_cholesky`."""
    inverse = inverted(matrices)
    solved = right @ inverse
    # In float32, an inverse is coarse by the condition of its matrix; a second step removes that.
    return solved + (right - solved @ matrices) @ inverse


def _quantile(values: Tensor, is_counted: Tensor, share: float) -> Tensor:
    """Quantile of the values [n] that count, between two of them in proportion."""
    ordered = torch.where(is_counted, values, torch.full((), BEYOND)).sort().values
    place = share * (is_counted.double().sum() - 1)
    below, above = place.floor().long(), place.ceil().long()
    low, high = (ordered.index_select(0, at[None])[0] for at in (below, above))
    return low + (place - below) * (high - low)


def _turned(turns: Tensor) -> tuple[Tensor, Tensor]:
    """Cosine and sine of angles in turns."""
    angles = 2 * math.pi * turns
    return angles.cos(), angles.sin()


def _length(count: Tensor) -> int:
    """A count as a length that data decide, at least 1."""
    length: int = count.item()  # type: ignore[assignment]
    torch._check(length >= 1)
    torch._check(length < 2**31)
    return length


def _reach(slopes: Tensor, n_views: int) -> int:
    """Pixels that filters reach along an axis, at slopes [N]."""
    farthest = snapped(slopes.abs().amax(0) * ((n_views - 1) / 2))
    return _length(farthest.ceil().long() + separable_wiener.TAIL)


def _continued(light: Tensor, reach: int, axis: int) -> Tensor:
    """Views whose outermost pixels go on beyond the border."""
    place = torch.arange(light.shape[axis] + 2 * reach) - reach
    return light.index_select(axis, place.clamp(min=0).clamp(max=light.shape[axis] - 1))


def _factors(taps: Tensor, period: int) -> Tensor:
    """Real and imaginary part of what taps [N, I, T] about 0 do to each frequency of a period, [2, N, I, K]."""
    place, k = torch.arange(taps.shape[2]) - taps.shape[2] // 2, torch.arange(period // 2 + 1)
    cos, sin = _turned(wrapped(place[:, None] * k, period) / number(period))
    return torch.stack([taps @ cos, taps @ sin])


def _rows(taps: Tensor, length: int) -> Tensor:
    """What each of some rows takes by taps [N, I, T] about it of rows that are continued, [N, I, L, L + T]."""
    n_taps = taps.shape[2]
    place = torch.arange(length + n_taps) - torch.arange(length)[:, None]
    is_tap = (place >= 0) & (place < n_taps)
    at = place.clamp(min=0).clamp(max=n_taps - 1)
    return gathered(taps, at.expand(*taps.shape[:2], -1, -1)) * is_tap.float()
