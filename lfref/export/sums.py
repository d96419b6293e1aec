"""Sums of views as graphs that other runtimes compute: light [V, U, C, H, W] and slopes [N] -> stack [N, C, H, W].

Shifts depend on the slopes, which a graph reads when it runs, so that all tables of positions and weights are computed
in the graph. Views are summed along each row of the grid (`across`), then the rows are summed (`down`), both as matrix
products.

- `CubicSum`: a block of eight output samples is a product of gathered samples and a matrix of
  taps. Runtimes gather long rows fast and single samples slowly, so the axis of the shift comes first.
- `filter_and_sum`: DFT along rows as products with matrices. ONNX's own DFT took 13 times as long at 540 samples and
  rounded 14 times as coarsely (ONNX Runtime 1.31).

Numbers are float32, and phases are reduced by whole turns in integers. Slopes in float32 make shifts uncertain by some
1e-7 of their size: shifts that near to half a pixel or a whole one are taken as such, since borders depend on it.
Letters: `v u` view row and column, `s` slope, `x` or `y` output sample of an axis, `i` whole and `t` fractional shift,
`L` samples along an axis, `T` taps, `K` other axes, `k` frequency.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from lfref import geometry
from lfref.refocus import batches, footprint
from lfref.refocus.sampling import INTERPOLATIONS

BLOCK = 8
"""Output samples of one product; 16 took 1.1 times as long (ONNX Runtime, 7x7 views of 375x540 pixels, 16 planes)."""
ROUNDING = 2.0**-22
"""Uncertainty of a shift, relative to its size: two roundings of float32, and a half of room."""


class Aperture(nn.Module):
    """Positions and weights of the views of a grid."""

    rows: Tensor
    columns: Tensor
    weights: Tensor

    def __init__(self, grid: tuple[int, int], weights: Sequence[Sequence[float]] | None) -> None:
        super().__init__()
        self.grid = grid
        given = None if weights is None else torch.tensor(weights, dtype=torch.float64)
        self.register_buffer("rows", geometry.angular_offsets(grid[0]).float())
        self.register_buffer("columns", geometry.angular_offsets(grid[1]).float())
        self.register_buffer("weights", batches.checked_weights(given, grid).float())

    def shifts(self, slopes: Tensor) -> tuple[Tensor, Tensor]:
        """Shift of each view row and of each view column in pixels, [N, V] and [N, U]."""
        rows, columns = (snapped(slopes[:, None] * offsets) for offsets in (self.rows, self.columns))
        return rows, columns

    def coverage(self, rows: Tensor, columns: Tensor, size: tuple[int, int]) -> Tensor:
        """Share of the aperture that has a sample, for shifts [N, V] and [N, U]: [N, 1, H, W]."""
        down, across = (
            _sampled(shifts, torch.arange(length), length).float()
            for shifts, length in zip((rows, columns), size, strict=True)
        )
        return (down.transpose(1, 2) @ self.weights @ across)[:, None]


class CubicSum(nn.Module):
    """Shift-and-sum by cubic interpolation, a mean over the views that have samples; see `lfref.shift_and_sum`."""

    places: Tensor

    def __init__(self, aperture: Aperture) -> None:
        super().__init__()
        self.aperture, self.interpolation = aperture, INTERPOLATIONS["cubic"]
        n_taps = len(self.interpolation.taps(0.0))
        # Place of each tap in the matrix of a block: [T, BLOCK, BLOCK + T - 1].
        places = torch.stack([torch.eye(BLOCK, BLOCK + n_taps - 1).roll(tap, 1) for tap in range(n_taps)])
        self.register_buffer("places", places)

    def forward(self, light: Tensor, slopes: Tensor) -> tuple[Tensor, Tensor]:
        """The mean of the views, and the share of the aperture that has samples, [N, 1, H, W]."""
        n_rows, n_columns, n_channels, height, width = light.shape
        rows, columns = self.aperture.shifts(slopes)
        across, down = self._tables(columns, width), self._tables(rows, height)
        n_planes, padded = slopes.shape[0], across[0].shape[2] * BLOCK
        first = torch.arange(n_columns)[:, None, None] * width  # of the samples of a view, one view after the other
        own = torch.arange(n_planes)[:, None, None] * height  # of the samples of a plane
        total = torch.zeros(())
        for v in range(n_rows):
            line = light[v].permute(0, 3, 1, 2).reshape(n_columns * width, n_channels * height)
            weights = across[1] * self.aperture.weights[v][:, None, None, None]
            sums = _products(line, (across[0] + first).transpose(1, 2), weights.permute(0, 2, 3, 1, 4))
            turned = sums.reshape(n_planes, padded, n_channels, height).permute(0, 3, 1, 2)
            turned = turned.reshape(n_planes * height, padded * n_channels)
            total = total + _products(turned, (down[0][:, v] + own)[:, :, None], down[1][:, v, :, :, None])
        # `narrow` has exactly this length, while a slice would have what the exporter cannot compare with it.
        whole = total.reshape(n_planes, down[0].shape[2] * BLOCK, padded, n_channels)
        stack = whole.narrow(1, 0, height).narrow(2, 0, width).permute(0, 3, 1, 2)
        covered = self.aperture.coverage(rows, columns, (height, width))
        return stack * footprint.inverse(covered, covered), covered

    def _tables(self, shifts: Tensor, length: int) -> tuple[Tensor, Tensor]:
        """Samples that each of M blocks of an axis reads, [N, u, M, J = 8 + T - 1], and weights, [N, u, M, 8, J]."""
        assert self.interpolation.weights is not None
        whole = shifts.floor()
        taps = torch.stack(self.interpolation.weights(shifts - whole), -1)  # [N, u, T]
        n_taps, n_samples = self.places.shape[0], self.places.shape[2]
        matrix = (taps @ self.places.reshape(n_taps, -1)).reshape(*shifts.shape, 1, BLOCK, n_samples)
        starts = torch.arange((length + BLOCK - 1) // BLOCK)[:, None] * BLOCK
        samples = starts + torch.arange(n_samples) - self.interpolation.before
        source = whole.long()[:, :, None, None] + samples
        is_sampled = _sampled(shifts, starts + torch.arange(BLOCK), length)
        return source.clamp(min=0).clamp(max=length - 1), matrix * is_sampled.float()[..., None]


def filter_and_sum(light: Tensor, factors: Tensor, down: Tensor) -> Tensor:
    """Sum of filtered views of a light field [V, U, C, H, W], whose rows are periods, [N, C, h, W].

    Args:
        light: Views.
        factors: Real and imaginary part of what multiplies each frequency of half a row's spectrum, [2, N, U, K].
        down: What each row of a plane takes of each row of the views, [N, V, h, H].
    """
    n_rows, n_columns, n_channels, height, width = light.shape
    n_planes, n_frequencies = factors.shape[1], width // 2 + 1
    # Even parts of rows have cosines only, odd parts sines: half a row of each takes half of the products.
    x = torch.arange(n_frequencies)
    opposite = wrapped(-x, width)
    is_pair = ((x > 0) & (2 * x < width)).float()[:, None]
    cosines, sines = (waves.narrow(1, 0, n_frequencies) for waves in _waves(width))  # [K, K]
    real, imaginary = factors[0], factors[1]
    # A complex product as one of real matrices, [N, 2, U, 2, K].
    matrix = torch.stack([torch.stack([real, -imaginary], 2), torch.stack([imaginary, real], 2)], 1)
    total = torch.zeros(())
    for v in range(n_rows):
        line = light[v].reshape(n_columns, n_channels * height, width).transpose(1, 2)
        first, last = line.index_select(1, x), line.index_select(1, opposite)
        parts = torch.stack([cosines @ (first + is_pair * last), sines @ (last - first)], 2)
        spectra = parts.reshape(n_columns, n_frequencies, -1).transpose(0, 1)
        mixing = matrix.reshape(-1, n_frequencies).transpose(0, 1).reshape(n_frequencies, 2 * n_planes, -1)
        mixed = mixing @ spectra.reshape(n_frequencies, 2 * n_columns, n_channels * height)
        by_plane = mixed.reshape(n_frequencies, n_planes, -1).transpose(0, 1)
        total = total + by_plane.reshape(n_planes, -1, height) @ down[:, v].transpose(1, 2)
    sums = total.reshape(n_planes, n_frequencies, 2, -1)
    inverse = _inverse(cosines, sines, width)
    even, odd = (inverse[:, part].transpose(0, 1) @ sums[:, :, part] for part in (0, 1))
    # Columns 0 to W / 2, then the opposite ones.
    column = torch.arange(width)
    place = torch.minimum(column, width - column) + n_frequencies * (column >= n_frequencies).long()
    whole = torch.cat([even + odd, even - odd], 1).index_select(1, place)
    return whole.transpose(1, 2).reshape(n_planes, n_channels, down.shape[2], width)


def snapped(shifts: Tensor) -> Tensor:
    """Shifts; what is within float32's rounding of a whole or half pixel is taken as such."""
    halves = (2 * shifts).round()
    return torch.where((2 * shifts - halves).abs() <= ROUNDING * halves.abs(), halves / 2, shifts)


def wrapped(places: Tensor, length: int) -> Tensor:
    """Integers modulo a length."""
    return places.remainder(number(length))


def number(length: int) -> Tensor:
    """A free length as a tensor: exporters know few operations of plain numbers, and files would need more of them."""
    return torch.full((), length)


def _sampled(shifts: Tensor, places: Tensor, length: int) -> Tensor:
    """Whether views have a sample at positions `place + shift`, for shifts [N, u] and places [...]: [N, u, ...]."""
    shifts = shifts.reshape(*shifts.shape, *[1] * places.ndim)
    whole = shifts.floor()
    position = places + whole.long()
    return (position >= 0) & (position < length - (shifts > whole).long())


def _products(data: Tensor, index: Tensor, weights: Tensor) -> Tensor:
    """Sums of rows of `data` [S, K], block by block.

    Args:
        data: Rows.
        index: Rows that each of M blocks reads, [N, M, ..., J].
        weights: Of each row in each of 8 sums, [N, M, 8, ..., J].

    Returns:
        [N, M * 8, K].
    """
    n_planes, n_blocks, n_sums = weights.shape[:3]
    matrix = weights.reshape(n_planes * n_blocks, n_sums, math.prod(weights.shape[3:]))
    rows = data.index_select(0, index.reshape(-1)).reshape(n_planes * n_blocks, matrix.shape[2], data.shape[1])
    return (matrix @ rows).reshape(n_planes, n_blocks * n_sums, data.shape[1])


def gathered(values: Tensor, places: Tensor) -> Tensor:
    """`values` [..., R] at places [..., *any]: [..., *any], by one index that counts through all values."""
    n_leading, length = values.ndim - 1, values.shape[-1]
    number = torch.arange(math.prod(values.shape[:-1])) * length
    first = number.reshape(*values.shape[:-1], *[1] * (places.ndim - n_leading))
    return values.reshape(-1).index_select(0, (places + first).reshape(-1)).reshape(places.shape)


def _waves(length: int) -> tuple[Tensor, Tensor]:
    """Cosines and sines of half a spectrum, [K, L]."""
    k, x = torch.arange(length // 2 + 1), torch.arange(length)
    angles = wrapped(k[:, None] * x, length) * (2 * math.pi) / number(length)
    return angles.cos(), angles.sin()


def _inverse(cosines: Tensor, sines: Tensor, length: int) -> Tensor:
    """Samples of a real signal from half its spectrum: weights of real and imaginary parts, [K, 2, L]."""
    k = torch.arange(length // 2 + 1)
    share = torch.where((k == 0) | (2 * k == length), torch.ones(()), torch.full((), 2.0)) / number(length)
    return torch.stack([cosines, -sines], 1) * share[:, None, None]
