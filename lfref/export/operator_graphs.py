"""Operators as graphs that other runtimes compute: light [V, U, C, H, W] and slopes [N] -> stack [N, C, H, W].

Every module has this one interface; a method of more parts, such as `wiener_graph`, is one more module.
`Deployed` wraps a module for files: it reads samples as pictures hold them. Shifts depend on the slopes, which a graph
reads when it runs, so that all tables of positions and weights are computed in the graph. All operators are separable:
views are summed along each row of the grid (`across`), then the rows are summed (`down`), both as matrix products.

- `SumByTaps` (nearest, linear, cubic): a block of eight output samples is a product of gathered samples and a matrix of
  taps. Runtimes gather long rows fast and single samples slowly, so the axis of the shift comes first.
- `SumByMatrices` (exact): a Fourier shift of a view that is continued beyond its edges, as one dense matrix.
- `FourierSum` (exact Fourier): DFT along rows as products with matrices. ONNX's own DFT took 13 times as long at 540
  samples and rounded 14 times as coarsely (ONNX Runtime 1.31).

Numbers are float32, and phases are reduced by whole turns in integers. Slopes in float32 make shifts uncertain by some
1e-7 of their size: shifts that near to half a pixel or a whole one are taken as such, since borders depend on it.
Letters: `v u` view row and column, `s` slope, `x` or `y` output sample of an axis, `i` whole and `t` fractional shift,
`L` samples along an axis, `T` taps, `K` other axes, `k` frequency.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lfref import geometry
from lfref.encoding import Encoding
from lfref.engines.files.manifest import to_light
from lfref.errors import InputError
from lfref.refocus import batches, footprint
from lfref.refocus.focus.slope_range import DisparityRange
from lfref.refocus.sampling import BORDERS, INTERPOLATIONS, Interpolation
from lfref.refocus.shift import shift_and_sum as cells
from lfref.refocus.shift.shift_torch import SEAM

BLOCK = 8
"""Output samples of one product; 16 took 1.1 times as long (ONNX Runtime, 7x7 views of 375x540 pixels, 16 planes)."""
ROUNDING = 2.0**-22
"""Uncertainty of a shift, relative to its size: two roundings of float32, and a half of room."""


class Deployed(nn.Module):
    """Samples as files hold them, and slopes -> stack in the same encoding, float32.

    Args:
        method: Light and slopes -> stack.
        samples: Type of the samples, a key of `lfref.engines.files.manifest.SAMPLE_TYPES`.
        encoding: Tone curve of samples and stack.
    """

    def __init__(self, method: nn.Module, samples: str, encoding: Encoding) -> None:
        super().__init__()
        self.method, self.samples, self.encoding = method, samples, encoding

    def forward(self, views: Tensor, slopes: Tensor) -> Tensor:
        """Refocus."""
        stack: Tensor = self.method(to_light(views, self.samples, self.encoding), slopes)
        return self.encoding.encode(stack)


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


class SumByTaps(nn.Module):
    """Shift-and-sum that reads few samples a pixel; see `lfref.shift_and_sum`.

    Args:
        aperture: Of the views.
        interpolation: One that reads few samples.
        border: As in `lfref.shift_and_sum`.
    """

    places: Tensor

    def __init__(self, aperture: Aperture, interpolation: Interpolation, border: str) -> None:
        super().__init__()
        self.aperture, self.border, self.interpolation = aperture, border, interpolation
        n_taps = len(self.interpolation.taps(0.0))
        # Place of each tap in the matrix of a block: [T, BLOCK, BLOCK + T - 1].
        places = torch.stack([torch.eye(BLOCK, BLOCK + n_taps - 1).roll(tap, 1) for tap in range(n_taps)])
        self.register_buffer("places", places)

    def forward(self, light: Tensor, slopes: Tensor) -> tuple[Tensor, Tensor | None]:
        """The sum of the views, and the share of the aperture that counts; None: all."""
        n_rows, n_columns, n_channels, height, width = light.shape
        rows, columns = self.aperture.shifts(slopes)
        if self.interpolation.rounds:
            rows, columns = (rows + 0.5).floor(), (columns + 0.5).floor()
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
        whole = (
            total.reshape(n_planes, down[0].shape[2] * BLOCK, padded, n_channels)
            .narrow(1, 0, height)
            .narrow(2, 0, width)
        )
        stack = whole.permute(0, 3, 1, 2)
        counts_only_samples = BORDERS[self.border].counts_only_samples
        return stack, self.aperture.coverage(rows, columns, (height, width)) if counts_only_samples else None

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
        if self.border == "wrap":
            return wrapped(source, length), matrix.expand(-1, -1, starts.shape[0], -1, -1)
        index = source.clamp(min=0).clamp(max=length - 1)
        if self.border == "zero":
            return index, matrix * (index == source).float()[:, :, :, None]
        if self.border == "edge":
            return index, matrix.expand(-1, -1, starts.shape[0], -1, -1)
        return index, matrix * _sampled(shifts, starts + torch.arange(BLOCK), length).float()[..., None]


class SumByMatrices(nn.Module):
    """Shift-and-sum with Fourier shifts, `interpolation="exact"`; arguments as in `SumByTaps`."""

    fade: Tensor

    def __init__(self, aperture: Aperture, border: str) -> None:
        super().__init__()
        self.aperture, self.border = aperture, border
        fade = 0.5 - 0.5 * torch.cos(torch.linspace(0, torch.pi, 2 * SEAM + 2, dtype=torch.float64))[1:-1]
        # Share of the last and of the first sample in the seam.
        self.register_buffer("fade", torch.stack([1 - fade, fade], 1).float())

    def forward(self, light: Tensor, slopes: Tensor) -> tuple[Tensor, Tensor | None]:
        """As in `SumByTaps`."""
        n_rows, n_columns, n_channels, height, width = light.shape
        rows, columns = self.aperture.shifts(slopes)
        farthest = torch.maximum(rows.abs().amax((0, 1)), columns.abs().amax((0, 1)))
        reach = farthest.ceil().long() + 1 + SEAM
        across, down = (
            self._matrices(s, n, reach, height + width + SEAM) for s, n in ((columns, width), (rows, height))
        )
        n_planes = slopes.shape[0]
        total = torch.zeros(())
        for v in range(n_rows):
            line = light[v].permute(0, 3, 1, 2).reshape(n_columns * width, n_channels * height)
            weighted = across * self.aperture.weights[v][:, None, None]
            sums = weighted.transpose(1, 2).reshape(n_planes, width, n_columns * width) @ line
            parts = sums.reshape(n_planes, width * n_channels, height)
            total = total + parts @ down[:, v].transpose(1, 2)
        stack = total.reshape(n_planes, width, n_channels, height).permute(0, 2, 3, 1)
        counts_only_samples = BORDERS[self.border].counts_only_samples
        return stack, self.aperture.coverage(rows, columns, (height, width)) if counts_only_samples else None

    def _matrices(self, shifts: Tensor, length: int, reach: Tensor, enough: int) -> Tensor:
        """What each output sample takes of each sample, [N, u, L, L]; no axis reaches farther than `enough` samples."""
        is_periodic = self.border == "wrap"
        period = number(length) if is_periodic else length + 2 * reach
        whole = shifts.floor()
        # The kernel at whole distances from -3 `enough` on, and its running sum.
        distances = torch.arange(6 * enough) - 3 * enough
        kernel = _periodic_sinc(distances, (shifts - whole)[..., None], period)
        x = torch.arange(length)
        moved = whole.long()[..., None] + x + 3 * enough  # place of the distance to sample 0, [N, u, L]
        matrix = gathered(kernel, moved[..., None] - x)
        if self.border in ("renormalize", "edge"):
            # The first and the last sample continue beyond the edges, and fade into each other at the seam.
            sums = kernel.cumsum(-1)
            plain = reach - SEAM
            before = gathered(sums, moved + plain) - gathered(sums, moved)
            after = gathered(sums, moved - length) - gathered(sums, moved - length - plain)
            seam = gathered(kernel, moved[..., None] - (length + plain) - torch.arange(2 * SEAM)) @ self.fade
            last = after + seam[..., 0]
            first = before + seam[..., 1]
            matrix = matrix + first[..., None] * (x == 0).float() + last[..., None] * (x == length - 1).float()
        if BORDERS[self.border].counts_only_samples:
            matrix = matrix * _sampled(shifts, x, length).float()[..., None]
        return matrix


class FourierSum(nn.Module):
    """Exact refocusing of periodic views, each for a cell of the aperture; see `lfref.exact_fourier`.

    Args:
        aperture: Of the views.
        fill: Side of a cell in view steps.
        disparity: At which cells do not blur, in pixels per view step.
    """

    def __init__(self, aperture: Aperture, fill: float = 0.0, disparity: float = 0.0) -> None:
        super().__init__()
        self.aperture, self.fill, self.disparity = aperture, fill, disparity

    def forward(self, light: Tensor, slopes: Tensor) -> Tensor:
        """Refocus."""
        rows, columns = self.aperture.shifts(slopes)
        widths = self.fill * (slopes - self.disparity)
        down = self._circulants(rows, widths, light.shape[3])
        # The mean stays as it is; in the spectrum it would be by far the largest number, and round as such.
        mean = light.mean((0, 1, 3, 4), keepdim=True)
        factors = self._factors(columns, widths, light.shape[4])
        return filter_and_sum(light - mean, factors, down, self.aperture.weights) + mean[0]

    def _factors(self, shifts: Tensor, widths: Tensor, length: int) -> Tensor:
        """Real and imaginary part of the factor of each frequency of half a spectrum, [2, N, u, K]."""
        k = torch.arange(length // 2 + 1)
        whole = shifts.floor()
        turns = wrapped(whole.long()[..., None] * k, length).float() + (shifts - whole)[..., None] * k
        angles = turns * (2 * math.pi) / number(length)
        blur = _sinc(widths[:, None, None] * k / number(length))
        is_nyquist = (2 * k == length).float()
        return torch.stack([angles.cos() * blur, angles.sin() * (1 - is_nyquist) * blur])

    def _circulants(self, shifts: Tensor, widths: Tensor, length: int) -> Tensor:
        """The same filter as a matrix, [N, u, L, L]."""
        factors = self._factors(shifts, widths, length)
        inverse = _inverse(*_waves(length), length)
        kernel = factors[0] @ inverse[:, 0] + factors[1] @ inverse[:, 1]
        y = torch.arange(length)
        return gathered(kernel, wrapped(y[:, None] - y, length).expand(*shifts.shape, -1, -1))


def filter_and_sum(light: Tensor, factors: Tensor, down: Tensor, weights: Tensor | None = None) -> Tensor:
    """Sum of filtered views of a light field [V, U, C, H, W], whose rows are periods, [N, C, h, W].

    Args:
        light: Views.
        factors: Real and imaginary part of what multiplies each frequency of half a row's spectrum, [2, N, U, K].
        down: What each row of a plane takes of each row of the views, [N, V, h, H].
        weights: Of the views, [V, U]; None: 1.
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
        weighted = matrix if weights is None else matrix * weights[v][:, None, None]
        mixing = weighted.reshape(-1, n_frequencies).transpose(0, 1).reshape(n_frequencies, 2 * n_planes, -1)
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


class Filled(nn.Module):
    """Planes of a sum of views, each blurred by the box of its cells, over the share of the aperture that counts.

    Args:
        method: Light and slopes -> sum and coverage.
        border: How planes continue beyond their edges.
        fill: Side of a cell in view steps; 0: no blur.
        disparity: At which cells do not blur, in pixels per view step.
    """

    def __init__(self, method: nn.Module, border: str, fill: float, disparity: float) -> None:
        super().__init__()
        self.method, self.fill, self.disparity = method, fill, disparity
        self.box = Box(border) if fill > 0 else None

    def forward(self, light: Tensor, slopes: Tensor) -> Tensor:
        """Refocus."""
        stack, covered = self.method(light, slopes)
        widths = self.fill * (slopes - self.disparity).abs()
        return finished(stack, covered, self.box, widths)


def finished(stack: Tensor, covered: Tensor | None, box: "Box | None", widths: Tensor) -> Tensor:
    """A sum of views [N, C, H, W], blurred by a box, over its coverage [N, 1, H, W]."""
    blurred = covered
    if box is not None:
        stack = box(stack, widths)
        blurred = None if covered is None else box(covered, widths)
    if covered is None or blurred is None:
        return stack
    return stack * footprint.inverse(covered, blurred)


class ThroughCells(nn.Module):
    """See `lfref.shift_and_sum_through_cells`; the graph estimates the range of disparities by gradients.

    Where views move so far that gradients fail, about 3 pixels per view step, the operator searches all slopes, and the
    graph does not: there it takes other cells than the operator.
    """

    def __init__(self, aperture: Aperture) -> None:
        super().__init__()
        self.method = SumByTaps(aperture, INTERPOLATIONS["cubic"], "renormalize")
        self.disparities, self.box = Disparities(aperture), Box("renormalize")

    def forward(self, light: Tensor, slopes: Tensor) -> Tensor:
        """Refocus."""
        stack, covered = self.method(light, slopes)
        return finished(stack, covered, self.box, cell_widths(light, slopes, self.disparities(light)))


def cell_widths(light: Tensor, slopes: Tensor, disparities: Tensor) -> Tensor:
    """Width of the box that blurs each plane in pixels, [N], for a range of `Disparities`."""
    widths = cells.cell_widths(slopes, DisparityRange(*disparities.unbind()))  # type: ignore[arg-type]
    size = torch.minimum(number(light.shape[3]), number(light.shape[4]))
    return torch.minimum(widths, size.float())


class Disparities(nn.Module):
    """Range of disparities by gradients: light [V, U, C, H, W] -> low end, mean and high end, [3], in pixels per view
    step."""

    row_views: Tensor
    column_views: Tensor
    steps_along_row: Tensor
    steps_along_column: Tensor
    shares: Tensor

    def __init__(self, aperture: Aperture) -> None:
        super().__init__()
        is_open = aperture.weights > 0
        # The row and the column with the most open views, as `lfref.refocus.shift.shift_and_sum.disparity_range`.
        self.row, self.column = cells.middlemost(is_open.sum(1)), cells.middlemost(is_open.sum(0))
        self.register_buffer("row_views", is_open[self.row].nonzero()[:, 0])
        self.register_buffer("column_views", is_open[:, self.column].nonzero()[:, 0])
        self.register_buffer("steps_along_row", aperture.columns[self.row_views].diff())
        self.register_buffer("steps_along_column", aperture.rows[self.column_views].diff())
        self.register_buffer("shares", torch.tensor([[cells.OUTLIERS], [1 - cells.OUTLIERS]]))

    def forward(self, light: Tensor) -> Tensor:
        """Estimate the range."""
        sizes = [number(length) for length in light.shape[3:]]
        factor = torch.div(torch.minimum(*sizes), cells.SMALLEST, rounding_mode="floor").clamp(min=1)
        factor = factor.clamp(max=cells.REDUCTION)
        # Reduced views stand in the corner of pictures of full size, since graphs know no other size.
        rows, columns = (_Reduced(length, size, factor) for length, size in zip(light.shape[3:], sizes, strict=True))
        along_row = light[self.row].index_select(0, self.row_views).mean(1)
        along_column = light[:, self.column].index_select(0, self.column_views).mean(1)
        moments = torch.zeros(())
        for views, steps, line in (
            (along_row, self.steps_along_row, columns),
            (along_column, self.steps_along_column, rows),
        ):
            small = rows.matrix @ views @ columns.matrix.transpose(0, 1)
            change, between = small[1:] - small[:-1], (small[1:] + small[:-1]) / 2
            axis = 2 if line is columns else 1
            rise = between.index_select(axis, line.after) - between.index_select(axis, line.before)
            run = line.run if line is columns else line.run[:, None]
            gradient = steps[:, None, None] * rise / run
            moments = moments + torch.stack([-(gradient * change).sum(0), gradient.square().sum(0)])
        is_inside = rows.is_inside[:, None] * columns.is_inside
        moments = moments * is_inside
        energy = moments.sum((1, 2))
        local = (F.avg_pool2d(moments[None], cells.WINDOW, 1, cells.WINDOW // 2)[0] * is_inside).flatten(1)
        disparity, order = (local[0] / local[1].clamp(min=FLAT)).sort()
        below = local[1].index_select(0, order).cumsum(0) / local[1].sum().clamp(min=FLAT)
        ends = disparity.index_select(0, (below < self.shares).long().sum(1).clamp(max=disparity.shape[0] - 1))
        middle = energy[:1] / energy[1:].clamp(min=FLAT)
        found = torch.cat([ends[:1], middle, ends[1:]]) * factor
        return torch.where(energy[1] >= FLAT, found, torch.zeros(()))


class _Reduced:
    """An axis whose samples are averaged by a factor, in an axis of full length."""

    def __init__(self, length: int, size: Tensor, factor: Tensor) -> None:
        place = torch.arange(length)
        n_reduced = torch.div(size, factor, rounding_mode="floor")
        self.is_inside = (place < n_reduced).float()
        group = torch.div(place, factor, rounding_mode="floor")
        self.matrix = (place[:, None] == group).float() * self.is_inside[:, None] / factor
        self.after, self.before = torch.minimum(place + 1, n_reduced - 1), (place - 1).clamp(min=0)
        self.run = (self.after - self.before).clamp(min=1).float()


FLAT = 1e-12
"""Energy of the gradients of flat views, as in `lfref.refocus.shift.shift_and_sum`."""
NODES = 7
"""Widths of boxes between two multiples of 2 pixels at which taps are tabulated; between them, a polynomial."""
WIDEST = 256
"""Widest box of the table in pixels. Wider ones end as it does, scaled to their height: that is true to 1e-5."""


class Box(nn.Module):
    """Images [N, C, H, W] blurred along both axes by a box of another width [N] for each plane, in pixels.

    The taps at the ends of a box are fitted (`footprint.taps`); graphs read them from a table.
    """

    ends: Tensor
    powers: Tensor

    def __init__(self, border: str) -> None:
        super().__init__()
        if border == "wrap":
            raise InputError("a graph with fill needs a border without wrap", got=border, remedy="take exact_fourier")
        self.border = border
        nodes = 0.5 - 0.5 * torch.cos(math.pi * (torch.arange(NODES, dtype=torch.float64) + 0.5) / NODES)
        n_steps = WIDEST // 2
        # Half of each filter ends with five fitted taps: [steps, NODES, ENDS].
        ends = torch.zeros(n_steps, NODES, footprint.ENDS, dtype=torch.float64)
        for step in range(n_steps):
            for place, node in enumerate(nodes.tolist()):
                taps = footprint.taps(2 * (step + node))
                half = taps[len(taps) // 2 :][-footprint.ENDS :]
                ends[step, place, -len(half) :] = torch.tensor(half, dtype=torch.float64)
        vandermonde = nodes[:, None] ** torch.arange(NODES)
        self.register_buffer("ends", torch.linalg.solve(vandermonde, ends).float())
        self.register_buffer("powers", torch.arange(NODES).float())

    def forward(self, images: Tensor, widths: Tensor) -> Tensor:
        """Blur."""
        height, width = images.shape[2:]
        down, across = self._matrices(widths, height), self._matrices(widths, width)
        return down[:, None] @ images @ across.transpose(1, 2)[:, None]

    def _matrices(self, widths: Tensor, length: int) -> Tensor:
        """What each output sample takes of each sample, [N, L, L]."""
        halves = widths / 2
        steps = (halves.ceil() - 1).clamp(min=0)
        listed, rest = steps.clamp(max=WIDEST // 2 - 1), halves - steps
        height = torch.where(steps > listed, (listed + rest) / halves.clamp(min=1), torch.ones(()))
        powers = height[:, None] * rest[:, None] ** self.powers
        ends = (powers[:, None] @ self.ends.index_select(0, listed.long()))[:, 0]  # [N, ENDS]
        # Tap at each distance: 1 / width inside, fitted at the ends, 0 beyond.
        place = torch.arange(length) + (footprint.ENDS - 3) - steps.long()[:, None]
        is_end = (place >= 0) & (place < footprint.ENDS)
        fitted = ends.gather(1, place.clamp(min=0).clamp(max=footprint.ENDS - 1))
        inside = 1 / widths.clamp(min=1)[:, None]  # boxes of less than four pixels have fitted taps only
        taps = torch.where(is_end, fitted, torch.where(place < 0, inside, torch.zeros(())))
        x = torch.arange(length)
        matrix = gathered(taps, (x[:, None] - x).abs().expand(widths.shape[0], -1, -1))
        if self.border != "edge":
            return matrix
        # What lies beyond an edge is taken of the outermost sample: whatever lacks of a sum of 1.
        sums = taps.cumsum(1)
        beyond = 0.5 * (1 + taps[:, :1]) - sums  # sum of the taps at greater distances than each
        first, last = beyond[:, :, None] * (x == 0).float(), beyond.flip(1)[:, :, None] * (x == length - 1).float()
        return matrix + first + last


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


def _sinc(x: Tensor) -> Tensor:
    """sin(pi x) / (pi x)."""
    angle = math.pi * x
    is_small = angle.abs() < 1e-4  # there it is 1 to float32's precision
    return torch.where(is_small, torch.ones(()), angle.sin() / torch.where(is_small, torch.ones(()), angle))


def _periodic_sinc(whole: Tensor, fraction: Tensor, period: Tensor) -> Tensor:
    """The kernel of trigonometric interpolation over a period at distances `whole` [R] + `fraction` [..., 1]."""
    near = whole - period * torch.div(2 * whole + period, 2 * period, rounding_mode="floor")
    angle = (near.float() + fraction) * (math.pi / period.float())
    # Of an even period, the Nyquist frequency counts half.
    even = torch.where(period.remainder(2) == 0, angle.cos(), torch.ones(()))
    sign = 1 - 2 * near.remainder(2).float()
    is_zero = angle.abs() < 1e-7
    sine = torch.where(is_zero, torch.ones(()), angle.sin())
    kernel = sign * (math.pi * fraction).sin() * even / (period.float() * sine)
    return torch.where(is_zero, torch.ones(()), kernel)


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
