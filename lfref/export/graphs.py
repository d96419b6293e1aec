"""What is exported of each kind of refocuser, and what its file says of it.

A network that reads views is exported as it is, and shift-and-sum as convolutions. Of a refiner the network is: what it
reads is made by lfref, by methods that no other runtime has.
Letters: those of `lfref.engines.files.manifest`.
"""

import copy
import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from lfref.engines.engine import Inputs
from lfref.engines.files.manifest import FEATURES, VIEWS, Graph
from lfref.errors import InputError
from lfref.export.convolutions import Sum, SumOfViews
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.nets.network import Network
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser import refined
from lfref.refocuser.features import refiner_inputs
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.operators import OperatorRefocuser
from lfref.refocuser.refined import RefinedRefocuser
from lfref.refocuser.refocuser import Refocuser

EXAMPLE = (2, 36, 44)
"""Light fields or planes, height and width that a module is followed with: no special case of any of them."""


@dataclass(frozen=True, eq=False)
class Exportable:
    """A refocuser as a graph."""

    graph: Graph
    told: Mapping[str, Any]
    """Of the `Manifest`: name, planes, is_linear, config."""
    inputs: Callable[[Sequence[LightField]], Inputs]
    """What the graph is given of light fields of one size."""
    wanted: Callable[..., Tensor]
    """What lfref makes of such inputs."""
    exact: Callable[..., Tensor]
    """The same in float64."""
    rounding: float = 1e-6
    """How far the graph itself may be from that, in light: additions of another order."""
    before: Callable[..., Tensor] | None = None
    """Of such inputs the pictures that a refiner corrects."""


def exportable(refocuser: Refocuser, planes: FocalPlanes, grid: tuple[int, int]) -> Exportable:
    """A refocuser as a graph.

    Args:
        refocuser: A network, a refiner or shift-and-sum, on the CPU.
        planes: That an operator is fixed to, and a refiner is tried with.
        grid: View rows and columns (V, U), likewise.

    Raises:
        InputError: It is none of these, or has options that no graph does.
    """
    for kind, made in KINDS.items():
        if isinstance(refocuser, kind):
            return made(refocuser, planes, grid)
    raise _unknown(refocuser.name)


class _Stack(nn.Module):
    """A network that is given nothing but views."""

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network = network

    def forward(self, views: Tensor) -> Tensor:
        """Refocus."""
        made: Tensor = self.network(views)
        return made


def _of_network(refocuser: NetworkRefocuser, planes: FocalPlanes, grid: tuple[int, int]) -> Exportable:
    network = refocuser.network
    if refocuser.planes is None or refocuser.grid is None:
        raise InputError("a network that is exported must make planes of its own of one grid", got=refocuser.name)
    (n_rows, n_columns), n_channels = refocuser.grid, int(network.config["channels"])
    n_fields, height, width = EXAMPLE
    views, stack = ("B", n_rows, n_columns, n_channels, "H", "W"), ("B", len(refocuser.planes), n_channels, "H", "W")
    example = torch.rand(n_fields, n_rows, n_columns, n_channels, height, width)
    config = {"network": {"name": network.name, **network.config}}
    told = {"planes": _planes(refocuser.planes), "is_linear": refocuser.is_linear, "config": config}
    graph = Graph(_Stack(network).eval(), {VIEWS: views}, stack, (example,))
    return Exportable(graph, {"name": refocuser.name, **told}, _views, network, _doubled(network))


def _of_refiner(refocuser: RefinedRefocuser, planes: FocalPlanes, grid: tuple[int, int]) -> Exportable:
    refiner, slopes = refocuser.refiner, planes.slopes
    n_features, n_channels = (int(refiner.config[name]) for name in ("n_features", "channels"))
    pictures = ("N", n_channels, "H", "W")
    axes = {FEATURES: ("N", n_features, "H", "W"), "pictures": pictures, "error_scale": ("N", 1, "H", "W")}
    n_planes, height, width = EXAMPLE
    example = tuple(torch.rand(n_planes, n_of_each, height, width) for _, n_of_each, *_ in axes.values())

    @torch.no_grad()
    def inputs(fields: Sequence[LightField]) -> Inputs:
        parts = [next(refiner_inputs(field, slopes, refocuser.base, refocuser.names)) for field in fields]
        return tuple(torch.cat(part).float().contiguous() for part in zip(*parts, strict=True))

    config = refined.payload(refiner, refocuser.base, refocuser.names)
    graph = Graph(refiner, axes, ("N", n_channels, "H", "W"), example)
    return Exportable(
        graph, {"name": refocuser.name, "config": config}, inputs, refiner, _doubled(refiner), before=_pictures
    )


def _pictures(features: Tensor, pictures: Tensor, error_scale: Tensor) -> Tensor:
    return pictures


def _of_operator(refocuser: OperatorRefocuser, planes: FocalPlanes, grid: tuple[int, int]) -> Exportable:
    operator, options = refocuser.operator, dict(getattr(refocuser.operator, "keywords", {}))
    unknown = {*options} - {"interpolation", "border", "fill", "disparity"}
    if getattr(operator, "func", operator) is not shift_and_sum or unknown:
        raise _unknown(refocuser.name)
    weights = None if refocuser.aperture is None else refocuser.aperture(grid)
    if weights is not None:
        options["weights"] = tuple(map(tuple, weights.tolist()))
    n_fields, height, width = EXAMPLE
    # Kernels are longer than so few pixels where planes are far from focus.
    reach = int(max(map(abs, planes.values)) * max(grid))
    views = torch.rand(n_fields, *grid, 3, height + reach, width + reach)
    module = SumOfViews(Sum(planes.values, grid, **options)).eval()
    graph = Graph(module, {VIEWS: ("B", *grid, "C", "H", "W")}, ("B", len(planes), "C", "H", "W"), (views,))
    told = {"planes": _planes(planes), "config": {"operator": shift_and_sum.__name__, "options": options}}
    wanted = functools.partial(refocuser, slopes=planes.slopes)

    def exact(views: Tensor) -> Tensor:
        return wanted(views.double())

    return Exportable(graph, {"name": refocuser.name, **told}, _views, wanted, exact, rounding=1e-5)


def _doubled(module: nn.Module) -> Callable[..., Tensor]:
    """What a module makes in float64."""

    def made(*inputs: Tensor) -> Tensor:
        stack: Tensor = copy.deepcopy(module).double()(*(each.double() for each in inputs))
        return stack

    return made


def _views(fields: Sequence[LightField]) -> Inputs:
    return (torch.stack([field.views for field in fields]).float().contiguous(),)


def _planes(planes: FocalPlanes) -> dict[str, Any]:
    return planes.as_dict() | {"alphas": None if planes.alphas is None else list(planes.alphas)}


def _unknown(name: str) -> InputError:
    return InputError(
        "what is exported must be a network, a refiner, or shift-and-sum with fixed options",
        got=name,
        remedy="take method=learned, shift_and_sum, shift_and_sum_cubic or shift_and_sum_cubic_fill",
    )


KINDS: dict[type[Refocuser], Callable[[Any, FocalPlanes, tuple[int, int]], Exportable]] = {
    NetworkRefocuser: _of_network,
    RefinedRefocuser: _of_refiner,
    OperatorRefocuser: _of_operator,
}
