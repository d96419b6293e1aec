"""Refocusers as graphs that other runtimes compute, with the entries of their manifest.

A network that reads views is exported as it is. For a refiner, only the network is exported: lfref computes its
features by methods that no other runtime has. Operators are built anew for other runtimes (`operator_graphs`), and
read the slopes as an input. Letters: those of `lfref.engines.files.manifest`.
"""

import copy
import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from lfref import encoding
from lfref.encoding import Encoding
from lfref.engines.engine import FP32, Inputs
from lfref.engines.files import manifest
from lfref.engines.files.manifest import FEATURES, SLOPES, VIEWS, Graph, Manifest
from lfref.errors import InputError, chosen
from lfref.export.operator_graphs import Aperture, Deployed, Filled, FourierSum, SumByMatrices, SumByTaps, ThroughCells
from lfref.export.wiener_graph import SeparableWiener
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.sampling import BORDERS, INTERPOLATIONS
from lfref.refocus.separable_wiener import separable_wiener
from lfref.refocus.shift.shift_and_sum import shift_and_sum, shift_and_sum_through_cells
from lfref.refocuser import networks
from lfref.refocuser.features import refiner_inputs
from lfref.refocuser.networks import NetworkRefocuser, RefinedRefocuser
from lfref.refocuser.refocuser import Operator, OperatorRefocuser, Refocuser

N, HEIGHT, WIDTH = 2, 36, 44
"""Number of light fields or planes, height and width with which a module is traced; none is a special case."""


class Samples(NamedTuple):
    """How the views are written that a file reads, and the stack that it makes."""

    type: str = "float32"
    """Of the views: float32, uint8 or uint16; the stack is float32."""
    encoding: Encoding = encoding.LINEAR
    """Tone curve of views and stack."""

    def of_light(self, light: Tensor) -> Tensor:
        """Samples of linear light."""
        return manifest.to_samples(light, self.type, self.encoding)


LINEAR = Samples()


def _as_it_is(pictures: Tensor) -> Tensor:
    return pictures


@dataclass(frozen=True, eq=False)
class Exportable:
    """A refocuser as a graph."""

    graph: Graph
    manifest_entries: Mapping[str, Any]
    """Entries of the `Manifest`: name, planes, is_linear, config, samples, encoding."""
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
    reads_batches: bool = True
    """Whether the graph reads several light fields at once."""
    in_light: Callable[[Tensor], Tensor] = _as_it_is
    """(pictures) -> their light: sRGB spreads the light of dark pixels by a factor of 13."""

    def manifest(self, precision: str = FP32, version: str = "", license: str | None = None) -> Manifest:
        """What a file of this graph says about itself."""
        entries = {"samples": "float32", "encoding": "linear"} | dict(self.manifest_entries)
        return Manifest(
            inputs=self.graph.inputs,
            output=self.graph.output,
            precision=precision,
            sha256=manifest.digest(self.graph.module, entries["config"]),
            version=version,
            license=license,
            notes=manifest.notes(self.graph.inputs, entries["samples"], entries["encoding"]),
            **entries,
        )


def exportable(
    refocuser: Refocuser, planes: FocalPlanes, grid: tuple[int, int], samples: Samples = LINEAR
) -> Exportable:
    """The graph of a network, a refiner or an operator of `OPERATORS` on the CPU; other methods raise InputError.

    Args:
        refocuser: The method.
        planes: At which operators and refiners are compared; their graphs take any slopes.
        grid: View rows and columns that an operator reads.
        samples: That an operator reads; networks read what they were trained on.
    """
    if isinstance(refocuser, OperatorRefocuser) and refocuser.function in OPERATORS:
        return _operator(refocuser, planes, grid, samples)
    if not isinstance(refocuser, NetworkRefocuser | RefinedRefocuser):
        raise InputError(
            "what is exported must be a network, a refiner, shift-and-sum, exact Fourier or separable_wiener",
            got=refocuser.name,
            remedy="take method=separable_wiener, learned, shift_and_sum, shift_and_sum_cubic_fill or exact_fourier",
        )
    if samples != LINEAR:
        got, remedy = f"samples={samples.type} encoding={samples.encoding}", "leave both out"
        raise InputError(f"{refocuser.name} reads float32 as in its training", got=got, remedy=remedy)
    return _network(refocuser) if isinstance(refocuser, NetworkRefocuser) else _refiner(refocuser, planes.slopes)


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
        "encoding": str(encoding.NONE if refocuser.is_linear is False else encoding.LINEAR),
        "config": {"network": {"name": network.name, **network.config}},
    }
    return Exportable(graph, entries, _views, network, functools.partial(_in_float64, network))


def _refiner(refocuser: RefinedRefocuser, slopes: Tensor) -> Exportable:
    refiner = refocuser.corrector
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


def _sum_graph(
    aperture: Aperture,
    interpolation: str = "linear",
    border: str = "renormalize",
    fill: float = 0.0,
    disparity: float = 0.0,
) -> nn.Module:
    chosen("border", border, BORDERS)
    record = chosen("interpolation", interpolation, INTERPOLATIONS)
    if record.weights is None:
        return Filled(SumByMatrices(aperture, border), border, fill, disparity)
    return Filled(SumByTaps(aperture, record, border), border, fill, disparity)


OPERATORS: dict[Operator, Callable[..., nn.Module]] = {
    shift_and_sum: _sum_graph,
    shift_and_sum_through_cells: ThroughCells,
    exact_fourier: FourierSum,
    separable_wiener: SeparableWiener,
}
"""Operator -> (aperture, options of the operator) -> module: light and slopes -> stack."""


def _operator(refocuser: OperatorRefocuser, planes: FocalPlanes, grid: tuple[int, int], samples: Samples) -> Exportable:
    options = dict(refocuser.options)
    weights = None if refocuser.aperture is None else refocuser.aperture(grid).tolist()
    if maps := [name for name, value in options.items() if not isinstance(value, str | int | float)]:
        remedy = "leave them out"
        raise InputError(f"options of an exported {refocuser.name} must be numbers", got=", ".join(maps), remedy=remedy)
    method = OPERATORS[refocuser.function](Aperture(grid, weights), **options)
    config = {"operator": refocuser.function.__name__, "options": options, "weights": weights}
    chosen("samples", samples.type, manifest.SAMPLE_TYPES)
    # Far from focus, pictures must be larger than the usual example.
    reach = int(max(map(abs, planes.values)) * max(grid))
    views = samples.of_light(torch.rand(*grid, 3, HEIGHT + reach, WIDTH + reach))
    graph = Graph(
        Deployed(method, samples.type, samples.encoding).eval(),
        {VIEWS: (*grid, "C", "H", "W"), SLOPES: ("N",)},
        ("N", "C", "H", "W"),
        (views, torch.tensor([-0.5, 0.0, 0.5])),
    )

    def inputs(fields: Sequence[LightField]) -> Inputs:
        (field,) = fields
        return samples.of_light(field.views.float()).contiguous(), planes.slopes.float()

    # Slopes in float32 stand for those of the planes.
    def reference(views: Tensor, slopes: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
        light = manifest.to_light(views, samples.type, samples.encoding, dtype)
        return samples.encoding.encode(refocuser(light, planes.slopes))

    entries = {
        "name": refocuser.name,
        "config": config,
        "samples": samples.type,
        "encoding": str(samples.encoding),
    }
    exact = functools.partial(reference, dtype=torch.float64)
    in_light = samples.encoding.decode
    # Its small systems amplify rounding.
    rounding = 5e-5 if refocuser.function is separable_wiener else 1e-5
    return Exportable(graph, entries, inputs, reference, exact, rounding, reads_batches=False, in_light=in_light)


def _in_float64(module: nn.Module, *inputs: Tensor) -> Tensor:
    stack: Tensor = copy.deepcopy(module).double()(*(tensor.double() for tensor in inputs))
    return stack


def _views(fields: Sequence[LightField]) -> Inputs:
    return (torch.stack([field.views for field in fields]).float().contiguous(),)


def _planes(planes: FocalPlanes) -> dict[str, Any]:
    return planes.as_dict() | {"alphas": None if planes.alphas is None else list(planes.alphas)}
