"""A refocuser as a file that other programs run: ONNX, PyTorch's PT2, or weights alone as safetensors.

ONNX and PT2 hold a network or an operator in float32 for pictures of any size; an operator's file reads slopes too.
The operator is the method itself, traced: where it would read a number on the host, the file goes the way of a GPU, and
where views move so far that gradients fail, about 3 pixels per view step, it does not search all slopes. Other
precisions are made of the file by the tools of whatever runs it. Safetensors hold the weights of a network, for
`lfref.load`.
A file gets its name once its pictures are those of the refocuser.
Letters: `B` light fields, `V U` view rows and columns, `N` planes, `C H W` channel, pixel row and column.
"""

import copy
import json
import logging
import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from lfref.errors import InputError, LfrefError, chosen
from lfref.extras import needed
from lfref.functional.psnr import psnr
from lfref.io import atomic, tensor_files
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.refocus.disparity import disparity_map
from lfref.refocus.focus import line_range
from lfref.refocuser.load import DESCRIPTION, SLOPES, STACK, VIEWS, Exported, load
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.refocuser import Operator, OperatorRefocuser, Refocuser

Axes = tuple[int | str, ...]
"""Lengths of axes; a letter where any length will do."""
SIZE = (2, 563, 587)
"""Number of light fields, height and width with which a graph is traced; none is a special case."""
TOLERANCE = 1e-4
"""Largest distance, in light, between pictures of a file and of its refocuser."""


OPERATORS = {
    "shift_and_sum": 1,
    "shift_and_sum_antialiased": line_range.REDUCTION * line_range.SMALLEST,
    "exact_fourier": 1,
    "separable_wiener": 1,
    "blockwise_wiener": disparity_map.LARGE,
}
"""Operators that files hold, and the least height and width of views: smaller ones are reduced by other factors."""


class Parity(NamedTuple):
    """Distance between the pictures of a file and of its refocuser."""

    max_error: float
    """Largest distance of two samples, in light."""
    psnr_db: float
    """Least PSNR of a plane."""


class Graph(NamedTuple):
    """A refocuser as a module that can be traced, and what its file says about it."""

    module: nn.Module
    inputs: dict[str, Axes]
    output: Axes
    example: tuple[Tensor, ...]
    description: dict[str, Any]
    """Plain values from which `load.Exported` makes a refocuser."""

    @property
    def free_axes(self) -> tuple[dict[int, Any], ...]:
        """The axes of the inputs that may have any length, as PyTorch's exporters take them."""
        free = torch.export.Dim.DYNAMIC
        inputs = self.inputs.values()
        return tuple({n: free for n, axis in enumerate(axes) if isinstance(axis, str)} for axes in inputs)


def export(refocuser: Refocuser, path: Path, fields: Sequence[LightField], slopes: Tensor) -> Parity:
    """Write a refocuser as a file.

    Args:
        refocuser: A network with planes of its own, or one of `OPERATORS`.
        path: `NAME.onnx`, `NAME.pt2` or `NAME.safetensors`.
        fields: Light fields on which the file is tried: alone, and beside their mirror images. An operator's file
            reads the grid of the first.
        slopes: Planes to which an operator is tried, in pixels per view step, [N].

    Returns:
        The largest differences between the pictures of the file and of the refocuser.

    Raises:
        LfrefError: The refocuser cannot be written like this, or pictures differ by more than `TOLERANCE`.
    """
    write = chosen("suffix of an exported file", path.suffix, WRITERS)
    with atomic.replacing(path) as partial:
        parity = compared(refocuser, write(partial, refocuser, fields[0].grid), fields, slopes)
        if not parity.max_error <= TOLERANCE:
            expected = f"{path.name} must compute the pictures of {refocuser.name} to {TOLERANCE:g}"
            raise LfrefError(expected, got=f"{parity.max_error:.2g}", remedy="no file was left; take another format")
    return parity


@torch.no_grad()
def compared(refocuser: Refocuser, file: Refocuser, fields: Sequence[LightField], slopes: Tensor) -> Parity:
    """Pictures of a file held against those of its refocuser; an error that is not finite is infinite."""
    planes = slopes if refocuser.planes is None else None
    errors, least = [0.0], math.inf
    for field in fields:
        for views in (field.views[None], torch.stack([field.views, field.views.flip(-1)])):
            ours, theirs = refocuser(views, planes), file(views, planes)
            error = float((ours - theirs).abs().max())
            errors.append(error if math.isfinite(error) else math.inf)
            least = min(least, float(psnr(theirs, ours).min()))
    return Parity(max(errors), least)


def graph_of(refocuser: Refocuser, grid: tuple[int, int]) -> Graph:
    """The graph of a network, or of an operator for views of a grid; InputError for others."""
    if isinstance(refocuser, NetworkRefocuser) and refocuser.planes is not None and refocuser.grid is not None:
        return _network(refocuser)
    if isinstance(refocuser, OperatorRefocuser) and refocuser.function.__name__ in OPERATORS:
        return _operator(refocuser, grid)
    raise InputError(
        f"a graph must be of a network with planes of its own, or of {', '.join(OPERATORS)}",
        got=refocuser.name,
        remedy="take method=blockwise_wiener",
    )


def _network(refocuser: NetworkRefocuser) -> Graph:
    network = refocuser.network
    assert refocuser.planes is not None
    assert refocuser.grid is not None
    channels = int(network.config.get("channels", 3))
    views: Axes = ("B", *refocuser.grid, channels, "H", "W")
    example = torch.empty(SIZE[0], *refocuser.grid, channels, *SIZE[1:])
    description = {
        "name": refocuser.name,
        VIEWS: views,
        "planes": refocuser.planes.as_dict(),
        "is_linear": refocuser.is_linear,
    }
    stack: Axes = ("B", len(refocuser.planes), channels, "H", "W")
    return Graph(_with_centred_norms(copy.deepcopy(network)), {VIEWS: views}, stack, (example,), description)


class OperatorGraph(nn.Module):
    """Views [V, U, C, H, W] and slopes [N] -> stack [N, C, H, W], by an operator whose options are bound."""

    def __init__(self, operator: Operator, options: dict[str, Any], least: int) -> None:
        super().__init__()
        self.operator, self.options, self.least = operator, options, least

    def forward(self, views: Tensor, slopes: Tensor) -> Tensor:
        """Refocus."""
        for length in views.shape[3:]:
            torch._check(length >= self.least)
        return self.operator(views, slopes, **self.options)


def _operator(refocuser: OperatorRefocuser, grid: tuple[int, int]) -> Graph:
    options = {} if refocuser.aperture is None else {"weights": refocuser.aperture(grid)}
    views: Axes = (*grid, "C", "H", "W")
    example = torch.empty(*grid, 3, *SIZE[1:]), torch.tensor([-0.5, 0.0, 0.5])
    least = OPERATORS[refocuser.function.__name__]
    description = {"name": refocuser.name, VIEWS: views, "least": least}
    module = OperatorGraph(refocuser.operator, options, least).eval()
    return Graph(module, {VIEWS: views, SLOPES: ("N",)}, ("N", "C", "H", "W"), example, description)


class Centred(nn.Module):
    """A normalisation that first centres its input, so that the precision of its own mean does not matter.

    On flat frames, the mean in runtimes that sum in float32 is off by more than the variation: pictures were off by
    0.15 for the RefNet of 12.5 million weights in ONNX Runtime.
    """

    def __init__(self, norm: nn.InstanceNorm2d | nn.GroupNorm) -> None:
        super().__init__()
        self.norm = norm
        self.n_groups = norm.num_groups if isinstance(norm, nn.GroupNorm) else norm.num_features

    def forward(self, features: Tensor) -> Tensor:
        """Normalise."""
        grouped = features.unflatten(1, (self.n_groups, -1))
        result: Tensor = self.norm((grouped - grouped.mean((2, 3, 4), keepdim=True)).flatten(1, 2))
        return result


def _with_centred_norms(module: nn.Module) -> nn.Module:
    """The module with every instance and group normalisation `Centred`, in place."""
    if isinstance(module, nn.InstanceNorm2d | nn.GroupNorm):
        return Centred(module)
    for name, child in module.named_children():
        setattr(module, name, _with_centred_norms(child))
    return module


def _write_onnx(path: Path, refocuser: Refocuser, grid: tuple[int, int]) -> Refocuser:
    graph = graph_of(refocuser, grid)
    with needed("an ONNX file"):
        import onnx
        import onnxruntime  # noqa: F401  runs the file below
        import onnxscript  # noqa: F401  PyTorch's exporter needs it
    with _quiet():
        with torch.no_grad():
            traced = torch.export.export(graph.module, graph.example, dynamic_shapes=graph.free_axes, strict=False)
        program = torch.onnx.export(traced, dynamo=True, verbose=False, optimize=False)
        assert program is not None
        _simplify(program.model)
    model = program.model_proto
    # The exporter's notes hold stack traces with paths of this machine.
    parts = (model.graph, *model.graph.node, *model.graph.initializer, *model.graph.value_info)
    for part in (*parts, *model.graph.input, *model.graph.output):
        part.ClearField("metadata_props")
        part.ClearField("doc_string")
    # The exporter cannot name the output itself: a value inside the graph may have that name.
    (output,) = model.graph.output
    names = {STACK: f"{STACK}_inside"} | {output.name: STACK}
    for node in model.graph.node:
        for of_node in (node.input, node.output):
            of_node[:] = [names.get(name, name) for name in of_node]
    for value in (*model.graph.value_info, output):
        value.name = names.get(value.name, value.name)
    for value, axes in zip((*model.graph.input, output), (*graph.inputs.values(), graph.output), strict=True):
        for place, axis in zip(value.type.tensor_type.shape.dim, axes, strict=True):
            setattr(place, "dim_param" if isinstance(axis, str) else "dim_value", axis)
    model.producer_name = "lfref"
    onnx.helper.set_model_props(model, {DESCRIPTION: json.dumps(graph.description)})
    path.write_bytes(model.SerializeToString())
    return load(path)


@contextmanager
def _quiet() -> Iterator[None]:
    """Without warnings of exporters, which report each value that they replace."""
    level = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(level)


def _simplify(model: Any) -> None:
    """Compute what is constant, and remove what nothing reads, in place.

    PyTorch's own optimiser also tries patterns at each operator, which takes minutes for large graphs; runtimes have
    such patterns themselves.
    """
    from onnx_ir.passes import Sequential, common
    from onnxscript import optimizer

    optimizer.inline(model)
    optimizer.fold_constants(model, onnx_shape_inference=True)
    passes = (
        common.IdentityEliminationPass(),
        common.RemoveUnusedNodesPass(),
        common.RemoveUnusedFunctionsPass(),
        common.RemoveUnusedOpsetsPass(),
        common.LiftConstantsToInitializersPass(lift_all_constants=True, size_limit=0),
        common.DeduplicateInitializersPass(),
        common.CommonSubexpressionEliminationPass(),
        common.NameFixPass(),
    )
    Sequential(*passes)(model)


def _write_pt2(path: Path, refocuser: Refocuser, grid: tuple[int, int]) -> Refocuser:
    graph = graph_of(refocuser, grid)
    with torch.no_grad():
        program = torch.export.export(graph.module, graph.example, dynamic_shapes=graph.free_axes)
    # Guards refuse pictures that need another padding than the example, though the graph pads any.
    program._guards_code.clear()
    torch.export.save(program, path, extra_files={DESCRIPTION: json.dumps(graph.description)})
    module = program.module()
    return Exported(lambda *inputs: module(*inputs), graph.description)


def _write_weights(path: Path, refocuser: Refocuser, grid: tuple[int, int]) -> Refocuser:
    if not isinstance(refocuser, NetworkRefocuser) or refocuser.planes is None:
        raise InputError(f"{tensor_files.SUFFIX} holds networks", got=refocuser.name, remedy="take .onnx or .pt2")
    network = refocuser.network
    entry = checkpoint.payload(network, refocuser.planes, refocuser.is_linear is not False)
    state = {checkpoint.PREFIX + name: weight for name, weight in network.state_dict().items()}
    checkpoint.write_weights(path, {"lfref": entry, "state_dict": state}, {})
    return load(path, net=type(network))


WRITERS: dict[str, Callable[[Path, Refocuser, tuple[int, int]], Refocuser]] = {
    ".onnx": _write_onnx,
    ".pt2": _write_pt2,
    tensor_files.SUFFIX: _write_weights,
}
"""Suffix -> function that writes a file for views of a grid, and returns it as a refocuser."""
