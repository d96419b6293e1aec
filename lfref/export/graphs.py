"""Refocusers as graphs that other runtimes compute, with the entries of their manifest.

A network that reads views is exported as it is. For a refiner, only the network is exported: lfref computes its
features by methods that no other runtime has. Shift-and-sum becomes convolutions, which every runtime has
(`SumOfViews`): for fixed slopes the taps of interpolation are constants. Each plane is a convolution over the views
along rows, then along columns, with zeros beyond the edges. With the border rule of lfref instead of zeros, only `P`
pixels beside each edge change, by the `q` samples at that edge: this difference is added as a product with a small
matrix. Then each plane is blurred by the box of its cells, and divided by its coverage.
Letters: those of `lfref.engines.files.manifest`; `u` view along one axis, `L` pixels along one axis, `G` groups of a
convolution, `M` outputs of a group.
"""

import copy
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lfref import geometry
from lfref.engines.engine import Inputs
from lfref.engines.files.manifest import FEATURES, VIEWS, Graph
from lfref.errors import InputError, chosen
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus import batches, footprint
from lfref.refocus.sampling import BORDERS, INTERPOLATIONS, Border, Interpolation, sampled
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser import networks
from lfref.refocuser.features import refiner_inputs
from lfref.refocuser.networks import NetworkRefocuser, RefinedRefocuser
from lfref.refocuser.refocuser import OperatorRefocuser, Refocuser

BORDERS_OF_GRAPHS = ("renormalize", "edge", "zero")


@dataclass(frozen=True)
class Sum:
    """The options of shift-and-sum; see `lfref.shift_and_sum`."""

    slopes: tuple[float, ...]
    """Slopes of the planes, in pixels per view step, [N]."""
    grid: tuple[int, int]
    """View rows and columns (V, U)."""
    interpolation: str = "linear"
    border: str = "renormalize"
    fill: float = 0.0
    disparity: float = 0.0
    weights: tuple[tuple[float, ...], ...] | None = None
    """Weight of each view, [V, U]; None: equal weights."""

    def __post_init__(self) -> None:
        chosen("border", self.border, dict.fromkeys(BORDERS_OF_GRAPHS))
        if chosen("interpolation", self.interpolation, INTERPOLATIONS).weights is None:
            got, remedy = self.interpolation, "take cubic interpolation"
            raise InputError("an exported sum must read few samples a pixel", got=got, remedy=remedy)

    @property
    def aperture(self) -> Tensor:
        """Weight of each view, float64, [V, U]; the sum is 1."""
        weights = None if self.weights is None else torch.tensor(self.weights, dtype=torch.float64)
        return torch.as_tensor(batches.checked_weights(weights, self.grid), dtype=torch.float64)

    def shifts(self, axis: int) -> list[list[float]]:
        """Shift of each view along an axis of the grid in each plane, in pixels, [N, u]."""
        snap = INTERPOLATIONS[self.interpolation].snap
        offsets = geometry.angular_offsets(self.grid[axis]).tolist()
        return [[snap(slope * offset) for offset in offsets] for slope in self.slopes]

    @property
    def widths(self) -> list[float]:
        """Width of the box by which each plane is blurred, in pixels, [N]."""
        return [self.fill * abs(slope - self.disparity) for slope in self.slopes]


class SumOfViews(nn.Module):
    """Views [B, V, U, C, H, W] -> stack [B, N, C, H, W], float32."""

    order: Tensor

    def __init__(self, options: Sum) -> None:
        super().__init__()
        groups = _groups(options)
        # Planes are computed group by group, then put back in their order.
        order = [plane for planes in groups for plane in planes]
        self.parts = nn.ModuleList(_Planes(options, planes) for planes in groups)
        self.register_buffer("order", torch.tensor([order.index(plane) for plane in range(len(order))]))
        self.boxes = nn.ModuleList(_Box(width, BORDERS[options.border]) for width in options.widths)
        self.counts_only_samples = BORDERS[options.border].counts_only_samples

    def forward(self, views: Tensor) -> Tensor:
        """Refocus."""
        n_fields, n_rows, n_columns, n_channels, height, width = views.shape
        images = views.permute(0, 3, 1, 2, 4, 5).reshape(-1, n_rows * n_columns, height, width)
        sums, covered = zip(*(part(images) for part in self.parts), strict=True)
        summed = torch.cat(sums, 1).index_select(1, self.order).split(1, 1)
        planes = [box(plane) for box, plane in zip(self.boxes, summed, strict=True)]
        if self.counts_only_samples:
            shares = torch.cat(covered).index_select(0, self.order).split(1)
            inverses = [footprint.inverse(own, box(own[None])[0]) for box, own in zip(self.boxes, shares, strict=True)]
            planes = [plane * inverse for plane, inverse in zip(planes, inverses, strict=True)]
        return torch.cat(planes, 1).reshape(n_fields, n_channels, -1, height, width).transpose(1, 2)


class _Planes(nn.Module):
    """Sum and coverage of a group of planes: [B, V * U, H, W] -> [B, N, H, W] and [N, H, W]."""

    aperture: Tensor
    rows: Tensor
    columns: Tensor

    def __init__(self, options: Sum, planes: Sequence[int]) -> None:
        super().__init__()
        rows, columns = ([options.shifts(axis)[plane] for plane in planes] for axis in (0, 1))
        ways = INTERPOLATIONS[options.interpolation], BORDERS[options.border]
        aperture = options.aperture
        # The weights of the views enter along rows; along columns the row sums are added as they are.
        shifts = [(columns[n], aperture[v].tolist()) for v in range(len(aperture)) for n in range(len(planes))]
        self.across = _Along(-1, shifts, len(aperture), *ways)
        self.down = _Along(-2, [(row, [1.0] * len(row)) for row in rows], len(planes), *ways)
        self.register_buffer("aperture", aperture.float())
        for name, axis_shifts in (("rows", rows), ("columns", columns)):
            # Pixels at both ends of an axis that have no sample in a view: as `lfref.refocus.sampling.sampled_span`.
            ends = [[(max(0, math.ceil(-s)), max(0, math.ceil(s))) for s in plane] for plane in axis_shifts]
            self.register_buffer(name, torch.tensor(ends))

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """The sum, and the share of the aperture that has a sample."""
        n_rows = len(self.aperture)
        along_rows = self.across(images)
        height, width = along_rows.shape[-2:]
        by_plane = along_rows.reshape(-1, n_rows, along_rows.shape[1] // n_rows, height, width).transpose(1, 2)
        sums = self.down(by_plane.reshape(-1, along_rows.shape[1], height, width))
        rows, columns = _sampled(self.rows, height), _sampled(self.columns, width)
        return sums, rows.transpose(1, 2) @ self.aperture @ columns


class _Along(nn.Module):
    """Convolutions along one axis, in groups of inputs: [B, G * u, H, W] -> [B, G * M, H, W].

    Args:
        axis: -1 (along rows of pixels) or -2 (along columns).
        shifts: For each output, shifts of its inputs in pixels and their weights, [G * M] times [u] each.
        n_groups: Number of groups, G.
        interpolation: Interpolation, which gives the taps.
        border: Border rule, which gives the samples beyond the edges.
    """

    kernel: Tensor
    edges: Tensor

    def __init__(
        self,
        axis: int,
        shifts: Sequence[tuple[Sequence[float], Sequence[float]]],
        n_groups: int,
        interpolation: Interpolation,
        border: Border,
    ) -> None:
        super().__init__()
        reach = max(abs(place) for line, _ in shifts for shift in line for place, _ in interpolation.taps(shift))
        kernel = torch.zeros(len(shifts), len(shifts[0][0]), 2 * reach + 1, dtype=torch.float64)
        edges = torch.zeros(2, len(shifts), len(shifts[0][0]), n_taps := len(interpolation.taps(0.0)), reach + n_taps)
        for place, (line, weights) in enumerate(shifts):
            for view, (shift, weight) in enumerate(zip(line, weights, strict=True)):
                for tap, of_sample in interpolation.taps(shift):
                    kernel[place, view, tap + reach] += weight * of_sample
                edges[:, place, view] = weight * _edge_matrices(shift, interpolation, border, n_taps, reach + n_taps)
        self.axis, self.n_groups = axis, n_groups
        self.padding = (0, reach) if axis == -1 else (reach, 0)
        self.register_buffer("kernel", kernel.float().unsqueeze(axis - 1 if axis == -1 else -1))
        # [2, G, u * q, M * P]
        edges = edges.unflatten(1, (n_groups, -1)).permute(0, 1, 3, 4, 2, 5).flatten(4).flatten(2, 3)
        self.register_buffer("edges", edges)
        self.n_taps, self.n_beside = n_taps, reach + n_taps

    def forward(self, images: Tensor) -> Tensor:
        """Convolve."""
        sums = F.conv2d(images, self.kernel, padding=self.padding, groups=self.n_groups)
        length = sums.shape[self.axis]
        first = images.narrow(self.axis, 0, self.n_taps)
        last = images.narrow(self.axis, length - self.n_taps, self.n_taps)
        rest = length - self.n_beside
        head = sums.narrow(self.axis, 0, self.n_beside) + self._beside(first, self.edges[0])
        sums = torch.cat([head, sums.narrow(self.axis, self.n_beside, rest)], self.axis)
        tail = sums.narrow(self.axis, rest, self.n_beside) + self._beside(last, self.edges[1])
        return torch.cat([sums.narrow(self.axis, 0, rest), tail], self.axis)

    def _beside(self, samples: Tensor, matrices: Tensor) -> Tensor:
        """Light that the q outermost samples at one edge add to the P pixels at that edge."""
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


def _groups(options: Sum) -> list[list[int]]:
    """Groups of planes with similar shifts of their views, so that no kernel is much longer than its taps need."""
    groups: dict[int, list[int]] = {}
    for plane, lines in enumerate(zip(options.shifts(0), options.shifts(1), strict=True)):
        reach = max(abs(shift) for line in lines for shift in line)
        groups.setdefault(math.ceil(math.log2(reach + 1)), []).append(plane)
    return list(groups.values())


def _sampled(ends: Tensor, length: int) -> Tensor:
    """1 where views have a sample, else 0, float32; `ends` are the pixels without a sample: [N, u, 2] -> [N, u, L]."""
    places = torch.arange(length, device=ends.device)
    return ((places >= ends[..., :1]) & (places < length - ends[..., 1:])).float()


def _edge_matrices(shift: float, interpolation: Interpolation, border: Border, n_samples: int, n_beside: int) -> Tensor:
    """Difference, at the edges, between the border rule and zeros beyond the edges, float64.

    Returns:
        Weight of each of the first and of the last q samples in the P pixels beside the edge, [2, q, P].
    """
    # The axis is so long that its two edges do not touch.
    length = 4 * n_beside
    places = torch.arange(length)
    whole, zeros = torch.zeros(2, length, length, dtype=torch.float64)
    counts = sampled([shift], length)[0] if border.counts_only_samples else torch.ones(length, dtype=torch.float64)
    for tap, weight in interpolation.taps(shift):
        for matrix, rule in ((whole, border), (zeros, BORDERS["zero"])):
            index, kept = rule.tap(places + tap, torch.full((length,), weight, dtype=torch.float64), length)
            matrix.index_put_((index, places), kept * (counts if matrix is whole else 1.0), accumulate=True)
    difference = whole - zeros
    return torch.stack([difference[:n_samples, :n_beside], difference[-n_samples:, -n_beside:]])


N, HEIGHT, WIDTH = 2, 36, 44
"""Number of light fields or planes, height and width with which a module is traced; none is a special case."""


@dataclass(frozen=True, eq=False)
class Exportable:
    """A refocuser as a graph."""

    graph: Graph
    manifest_entries: Mapping[str, Any]
    """Entries of the `Manifest`: name, planes, is_linear, config."""
    inputs: Callable[[Sequence[LightField]], Inputs]
    """(light fields of one size) -> inputs of the graph."""
    reference: Callable[..., Tensor]
    """(inputs) -> the pictures that lfref computes."""
    exact: Callable[..., Tensor]
    """(inputs) -> the pictures that lfref computes in float64."""
    rounding: float = 1e-6
    """Distance in light between the graph and lfref that the order of additions explains."""
    uncorrected: Callable[..., Tensor] | None = None
    """(inputs) -> the pictures that a refiner corrects."""


def exportable(refocuser: Refocuser, planes: FocalPlanes, grid: tuple[int, int]) -> Exportable:
    """The graph of a network, a refiner or shift-and-sum on the CPU; other methods raise InputError.

    An operator is exported for `planes` and `grid` (view rows and columns); a refiner is only compared at them.
    """
    if isinstance(refocuser, NetworkRefocuser):
        return _network(refocuser)
    if isinstance(refocuser, RefinedRefocuser):
        return _refiner(refocuser, planes.slopes)
    allowed = {"interpolation", "border", "fill", "disparity"}
    if (
        isinstance(refocuser, OperatorRefocuser)
        and refocuser.function is shift_and_sum
        and refocuser.options.keys() <= allowed
    ):
        return _shift_and_sum(refocuser, planes, grid)
    raise InputError(
        "what is exported must be a network, a refiner, or shift-and-sum with fixed options",
        got=refocuser.name,
        remedy="take method=learned, shift_and_sum, shift_and_sum_cubic or shift_and_sum_cubic_fill",
    )


def _network(refocuser: NetworkRefocuser) -> Exportable:
    network, planes, grid = refocuser.network, refocuser.planes, refocuser.grid
    if planes is None or grid is None:
        raise InputError("a network that is exported must make planes of its own of one grid", got=refocuser.name)
    channels = int(network.config.get("channels", 3))
    graph = Graph(
        network,
        {VIEWS: ("B", *grid, channels, "H", "W")},
        ("B", len(planes), channels, "H", "W"),
        (torch.rand(N, *grid, channels, HEIGHT, WIDTH),),
    )
    entries = {
        "name": refocuser.name,
        "planes": _planes(planes),
        "is_linear": refocuser.is_linear,
        "config": {"network": {"name": network.name, **network.config}},
    }
    return Exportable(graph, entries, _views, network, functools.partial(_in_float64, network))


def _refiner(refocuser: RefinedRefocuser, slopes: Tensor) -> Exportable:
    refiner = refocuser.refiner
    channels = int(refiner.config["channels"])
    lengths = {FEATURES: int(refiner.config["n_features"]), "pictures": channels, "error_scale": 1}
    graph = Graph(
        refiner,
        {name: ("N", length, "H", "W") for name, length in lengths.items()},
        ("N", channels, "H", "W"),
        tuple(torch.rand(N, length, HEIGHT, WIDTH) for length in lengths.values()),
    )

    @torch.no_grad()
    def inputs(fields: Sequence[LightField]) -> Inputs:
        parts = [next(refiner_inputs(field, slopes, refocuser.base, refocuser.names)) for field in fields]
        return tuple(torch.cat(part).float().contiguous() for part in zip(*parts, strict=True))

    def pictures(features: Tensor, pictures: Tensor, error_scale: Tensor) -> Tensor:
        return pictures

    config = networks.refiner_entry(refiner, refocuser.base, refocuser.names)
    exact = functools.partial(_in_float64, refiner)
    entries = {"name": refocuser.name, "config": config}
    return Exportable(graph, entries, inputs, refiner, exact, uncorrected=pictures)


def _shift_and_sum(refocuser: OperatorRefocuser, planes: FocalPlanes, grid: tuple[int, int]) -> Exportable:
    options = dict(refocuser.options)
    if refocuser.aperture is not None:
        options["weights"] = tuple(map(tuple, refocuser.aperture(grid).tolist()))
    # Far from focus, kernels are longer than the usual example.
    reach = int(max(map(abs, planes.values)) * max(grid))
    graph = Graph(
        SumOfViews(Sum(planes.values, grid, **options)).eval(),
        {VIEWS: ("B", *grid, "C", "H", "W")},
        ("B", len(planes), "C", "H", "W"),
        (torch.rand(N, *grid, 3, HEIGHT + reach, WIDTH + reach),),
    )
    config = {"operator": shift_and_sum.__name__, "options": options}
    entries = {"name": refocuser.name, "planes": _planes(planes), "config": config}

    def exact(views: Tensor) -> Tensor:
        return refocuser(views.double(), planes.slopes)

    return Exportable(graph, entries, _views, functools.partial(refocuser, slopes=planes.slopes), exact, rounding=1e-5)


def _in_float64(module: nn.Module, *inputs: Tensor) -> Tensor:
    stack: Tensor = copy.deepcopy(module).double()(*(tensor.double() for tensor in inputs))
    return stack


def _views(fields: Sequence[LightField]) -> Inputs:
    return (torch.stack([field.views for field in fields]).float().contiguous(),)


def _planes(planes: FocalPlanes) -> dict[str, Any]:
    return planes.as_dict() | {"alphas": None if planes.alphas is None else list(planes.alphas)}
