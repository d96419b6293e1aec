"""Refocusers as graphs that other runtimes compute, with the entries of their manifest.

A network that reads views is exported as it is, and shift-and-sum as convolutions. Of a refiner only the network is
exported: lfref computes its features by methods that no other runtime has.
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
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser import refined
from lfref.refocuser.features import refiner_inputs
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.operators import OperatorRefocuser
from lfref.refocuser.refined import RefinedRefocuser
from lfref.refocuser.refocuser import Refocuser

N, HEIGHT, WIDTH = 2, 36, 44
"""Light fields or planes, height and width with which a module is traced: no special case of any of them."""


@dataclass(frozen=True, eq=False)
class Exportable:
    """A refocuser as a graph."""

    graph: Graph
    manifest_entries: Mapping[str, Any]
    """Of the `Manifest`: name, planes, is_linear, config."""
    inputs: Callable[[Sequence[LightField]], Inputs]
    """(light fields of one size) -> inputs of the graph."""
    reference: Callable[..., Tensor]
    """(inputs) -> what lfref computes of them."""
    exact: Callable[..., Tensor]
    """(inputs) -> what lfref computes of them in float64."""
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

    config = refined.payload(refiner, refocuser.base, refocuser.names)
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
