"""Shift-and-sum as convolutions, which every runtime has: for fixed slopes its taps are numbers.

Along rows and then along columns each plane is a convolution over the views, with zeros beyond the edges; what lfref
reads there instead concerns a few samples at each edge and a few pixels beside them, so that it is added as a product
with a small matrix. Then the sum is seen through cells, and divided by the coverage.
Letters: `V U` view rows and columns, `u` view along one axis, `N` planes, `C H W` channel, pixel row and column, `L`
pixels along one axis, `K` taps, `q` samples at an edge, `P` pixels beside it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lfref import geometry
from lfref.errors import InputError, chosen
from lfref.refocus import batches, footprint, footprint_blur
from lfref.refocus.sampling import BORDERS, INTERPOLATIONS, Border, Interpolation, sampled

BORDERS_OF_GRAPHS = ("renormalize", "edge", "zero")


@dataclass(frozen=True)
class Sum:
    """What shift-and-sum is asked for."""

    slopes: tuple[float, ...]
    """Of the planes, in pixels per view step, [N]."""
    grid: tuple[int, int]
    """View rows and columns (V, U)."""
    interpolation: str = "linear"
    border: str = "renormalize"
    fill: float = 0.0
    """Side of the cell that each view stands for, in view steps."""
    disparity: float = 0.0
    """At which cells do not blur, in pixels per view step."""
    weights: tuple[tuple[float, ...], ...] | None = None
    """Of each view, [V, U]; None: all alike."""

    def __post_init__(self) -> None:
        way = chosen("interpolation", self.interpolation, INTERPOLATIONS)
        chosen("border", self.border, dict.fromkeys(BORDERS_OF_GRAPHS))
        if way.weights is None:
            raise InputError(
                "what is exported must read few samples", got=self.interpolation, remedy="take cubic interpolation"
            )

    @property
    def aperture(self) -> Tensor:
        """Weight of each view, together 1, float64, [V, U]."""
        weights = None if self.weights is None else torch.tensor(self.weights, dtype=torch.float64)
        return torch.as_tensor(batches.checked_weights(weights, self.grid), dtype=torch.float64)

    def shifts(self, axis: int) -> list[list[float]]:
        """How far each plane shifts the views along an axis of the grid, in pixels, [N, u]."""
        way = INTERPOLATIONS[self.interpolation]
        offsets = geometry.angular_offsets(self.grid[axis]).tolist()
        return [[way.snap(slope * offset) for offset in offsets] for slope in self.slopes]

    @property
    def widths(self) -> list[float]:
        """Of the box that each plane is blurred by, in pixels, [N]."""
        return [self.fill * abs(slope - self.disparity) for slope in self.slopes]


class SumOfViews(nn.Module):
    """Views [B, V, U, C, H, W] -> stack [B, N, C, H, W], float32.

    Args:
        asked: What is summed.
    """

    order: Tensor

    def __init__(self, asked: Sum) -> None:
        super().__init__()
        groups = _alike(asked)
        order = [plane for planes in groups for plane in planes]
        self.parts = nn.ModuleList(_Planes(asked, planes) for planes in groups)
        self.register_buffer("order", torch.tensor([order.index(plane) for plane in range(len(order))]))
        self.boxes = nn.ModuleList(_Box(width, BORDERS[asked.border]) for width in asked.widths)
        self.counts_only_samples = BORDERS[asked.border].counts_only_samples

    def forward(self, views: Tensor) -> Tensor:
        """Refocus."""
        n_fields, n_rows, n_columns, n_channels, height, width = views.shape
        images = views.permute(0, 3, 1, 2, 4, 5).reshape(-1, n_rows * n_columns, height, width)
        sums, covered = zip(*(part(images) for part in self.parts), strict=True)
        summed = torch.cat(sums, 1).index_select(1, self.order).split(1, 1)
        planes = [box(plane) for box, plane in zip(self.boxes, summed, strict=True)]
        if self.counts_only_samples:
            shares = torch.cat(covered).index_select(0, self.order).split(1)
            inverses = [
                footprint_blur.inverse(own, box(own[None])[0]) for box, own in zip(self.boxes, shares, strict=True)
            ]
            planes = [plane * inverse for plane, inverse in zip(planes, inverses, strict=True)]
        return torch.cat(planes, 1).reshape(n_fields, n_channels, -1, height, width).transpose(1, 2)


class _Planes(nn.Module):
    """The sums of some planes, whose views shift about as far, and their coverage.

    [B, V * U, H, W] -> [B, N, H, W] and [N, H, W].
    """

    aperture: Tensor
    rows: Tensor
    columns: Tensor

    def __init__(self, asked: Sum, planes: Sequence[int]) -> None:
        super().__init__()
        rows, columns = ([asked.shifts(axis)[plane] for plane in planes] for axis in (0, 1))
        ways = INTERPOLATIONS[asked.interpolation], BORDERS[asked.border]
        aperture = asked.aperture
        # Along a row every view has its weight; what comes of it is added up down the columns as it is.
        shifts = [(columns[n], aperture[v].tolist()) for v in range(len(aperture)) for n in range(len(planes))]
        self.across = _Along(-1, shifts, len(aperture), *ways)
        self.down = _Along(-2, [(row, [1.0] * len(row)) for row in rows], len(planes), *ways)
        self.register_buffer("aperture", aperture.float())
        for name, told in (("rows", rows), ("columns", columns)):
            self.register_buffer(name, torch.tensor([[_left_out(shift) for shift in plane] for plane in told]))

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Add up."""
        n_rows = len(self.aperture)
        along_rows = self.across(images)
        height, width = along_rows.shape[-2:]
        by_plane = along_rows.reshape(-1, n_rows, along_rows.shape[1] // n_rows, height, width).transpose(1, 2)
        return self.down(by_plane.reshape(-1, along_rows.shape[1], height, width)), self._coverage(images)

    def _coverage(self, images: Tensor) -> Tensor:
        """Share of the aperture that has a sample, [N, H, W]."""
        rows, columns = (_sampled(ends, images.shape[axis]) for axis, ends in ((-2, self.rows), (-1, self.columns)))
        return rows.transpose(1, 2) @ self.aperture @ columns


class _Along(nn.Module):
    """Convolutions along one axis, in groups of inputs: [B, G * u, H, W] -> [B, G * M, H, W].

    Args:
        axis: -1 (columns) or -2 (rows).
        shifts: Of the inputs of each output in pixels, and their weights, [G * M] times [u] each.
        n_groups: Groups, G, of as many outputs.
        way: Interpolation.
        border: What is read beyond the edges.
    """

    kernel: Tensor
    edges: Tensor

    def __init__(
        self,
        axis: int,
        shifts: Sequence[tuple[Sequence[float], Sequence[float]]],
        n_groups: int,
        way: Interpolation,
        border: Border,
    ) -> None:
        super().__init__()
        reach = max(abs(place) for line, _ in shifts for shift in line for place, _ in way.taps(shift))
        kernel = torch.zeros(len(shifts), len(shifts[0][0]), 2 * reach + 1, dtype=torch.float64)
        edges = torch.zeros(2, len(shifts), len(shifts[0][0]), n_taps := len(way.taps(0.0)), reach + n_taps)
        for place, (line, weights) in enumerate(shifts):
            for view, (shift, weight) in enumerate(zip(line, weights, strict=True)):
                for tap, of_sample in way.taps(shift):
                    kernel[place, view, tap + reach] += weight * of_sample
                edges[:, place, view] = weight * _at_edges(shift, way, border, n_taps, reach + n_taps)
        self.axis, self.n_groups = axis, n_groups
        self.padding = (0, reach) if axis == -1 else (reach, 0)
        self.register_buffer("kernel", kernel.float().unsqueeze(axis - 1 if axis == -1 else -1))
        # [2, G, u * q, M * P]
        edges = edges.unflatten(1, (n_groups, -1)).permute(0, 1, 3, 4, 2, 5).flatten(4).flatten(2, 3)
        self.register_buffer("edges", edges)
        self.n_taps, self.n_beside = n_taps, reach + n_taps

    def forward(self, images: Tensor) -> Tensor:
        """Convolve."""
        made = F.conv2d(images, self.kernel, padding=self.padding, groups=self.n_groups)
        length = made.shape[self.axis]
        first = images.narrow(self.axis, 0, self.n_taps)
        last = images.narrow(self.axis, length - self.n_taps, self.n_taps)
        rest = length - self.n_beside
        head = made.narrow(self.axis, 0, self.n_beside) + self._beside(first, self.edges[0])
        made = torch.cat([head, made.narrow(self.axis, self.n_beside, rest)], self.axis)
        tail = made.narrow(self.axis, rest, self.n_beside) + self._beside(last, self.edges[1])
        return torch.cat([made.narrow(self.axis, 0, rest), tail], self.axis)

    def _beside(self, samples: Tensor, matrices: Tensor) -> Tensor:
        """What samples at an edge add beside it."""
        by_group = samples.transpose(-1, self.axis).unflatten(1, (self.n_groups, -1))  # [B, G, u, L, q]
        added = by_group.transpose(2, 3).flatten(3) @ matrices  # [B, G, L, M * P]
        return added.unflatten(-1, (-1, self.n_beside)).transpose(2, 3).flatten(1, 2).transpose(-1, self.axis)


class _Box(nn.Module):
    """Images blurred by a box along both axes, [B, 1, H, W]."""

    taps: Tensor

    def __init__(self, width: float, border: Border) -> None:
        super().__init__()
        taps = torch.tensor(footprint.taps(width))
        self.radius = len(taps) // 2
        self.mode = "constant" if border.counts_only_samples else border.mode
        self.register_buffer("taps", taps[None, None, None])

    def forward(self, images: Tensor) -> Tensor:
        """Blur."""
        if self.radius == 0:
            return images
        extended = F.pad(images, (self.radius,) * 4, mode=self.mode)
        return F.conv2d(F.conv2d(extended, self.taps), self.taps.transpose(-1, -2))


def _alike(asked: Sum) -> list[list[int]]:
    """Planes in groups that reach about as far, so that no kernel is much longer than what it holds."""
    groups: dict[int, list[int]] = {}
    for plane, lines in enumerate(zip(asked.shifts(0), asked.shifts(1), strict=True)):
        reach = max(abs(shift) for line in lines for shift in line)
        groups.setdefault(math.ceil(math.log2(reach + 1)), []).append(plane)
    return list(groups.values())


def _left_out(shift: float) -> tuple[int, int]:
    """How many pixels at each end of an axis have no sample in a view that is shifted: as `borders.sampled_span`."""
    return max(0, math.ceil(-shift)), max(0, math.ceil(shift))


def _sampled(ends: Tensor, length: int) -> Tensor:
    """Where views have a sample, 1 or 0, float32: ends [N, u, 2] as of `_left_out` -> [N, u, L]."""
    places = torch.arange(length, device=ends.device)
    return ((places >= ends[..., :1]) & (places < length - ends[..., 1:])).float()


def _at_edges(shift: float, way: Interpolation, border: Border, n_samples: int, n_beside: int) -> Tensor:
    """What is read at the edges less what a convolution with zeros beyond them makes, float64.

    Returns:
        For the first and the last samples, how much each adds to the pixels beside the edge, [2, q, P].
    """
    length = 4 * n_beside
    places = torch.arange(length)
    whole, zeros = torch.zeros(2, length, length, dtype=torch.float64)
    counts = sampled([shift], length)[0] if border.counts_only_samples else torch.ones(length, dtype=torch.float64)
    for tap, weight in way.taps(shift):
        for matrix, rule in ((whole, border), (zeros, BORDERS["zero"])):
            index, kept = rule.tap(places + tap, torch.full((length,), weight, dtype=torch.float64), length)
            matrix.index_put_((index, places), kept * (counts if matrix is whole else 1.0), accumulate=True)
    apart = whole - zeros
    return torch.stack([apart[:n_samples, :n_beside], apart[-n_samples:, -n_beside:]])
