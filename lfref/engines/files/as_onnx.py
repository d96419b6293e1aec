"""ONNX files: run by ONNX Runtime, and by whatever else reads them.

Files are hostile input: weights in other files, and operators that come with libraries, are refused before a runtime
sees the model.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from lfref.engines import by_onnxruntime, by_openvino
from lfref.engines.engine import FP16, FP32, INT8, Run
from lfref.engines.files.manifest import KEY, Axes, Graph, Manifest, parse
from lfref.engines.files.network_copies import centred_norms, half_convolutions
from lfref.errors import CheckpointError, first_line
from lfref.io import atomic

PRECISIONS = (FP32, FP16, INT8)
"""ONNX Runtime has no convolutions in bfloat16 on CPUs."""
PACKAGES = by_onnxruntime.PACKAGES
DOMAINS = {"", "ai.onnx", "com.microsoft"}
"""Domains whose operators are part of the runtimes."""
LARGEST = 2**31
"""Bytes that a message of this kind may have."""


def write(path: Path, graph: Graph, manifest: Manifest) -> None:
    """Write a model as `NAME.onnx`.

    Raises:
        FileError: The disk refuses.
    """
    from onnx import helper

    if manifest.precision == FP16:
        graph = replace(graph, module=half_convolutions(graph.module, FP16))
    model = to_model(graph)
    if manifest.precision == INT8:
        model = by_onnxruntime.quantise(model, graph.patches)
    for values, all_axes in ((model.graph.input, graph.inputs.values()), (model.graph.output, [graph.output])):
        for value, axes in zip(values, all_axes, strict=True):
            _name_axes(value, axes)
    helper.set_model_props(model, {KEY: manifest.text()})
    with atomic.replacing(path) as partial:
        partial.write_bytes(model.SerializeToString())


def to_model(graph: Graph) -> Any:
    """A graph as a model that runtimes compute as precisely as PyTorch does."""
    workload = replace(graph.workload, network=centred_norms(graph.module).eval())
    return by_onnxruntime.export(workload, graph.free)


def _name_axes(value: Any, axes: Axes) -> None:
    for place, axis in zip(value.type.tensor_type.shape.dim, axes, strict=True):
        if isinstance(axis, str):
            place.dim_param = axis
        else:
            place.dim_value = axis


def read(path: Path) -> tuple[Run, Manifest]:
    """A model that `write` wrote, ready to run, and its manifest.

    Raises:
        CheckpointError: Another file, or one that this runtime cannot run.
    """
    import onnx

    try:
        if path.stat().st_size > LARGEST:
            raise CheckpointError(f"{path} must be smaller than 2 GiB", remedy="export it anew")
        content = path.read_bytes()
        model = onnx.load_model_from_string(content)
        _refuse_dependencies(path, model)
        manifest = parse(path, {entry.key: entry.value for entry in model.metadata_props}.get(KEY))
        run = by_onnxruntime.Session(content)
    except CheckpointError:
        raise
    # On a foreign file the libraries raise whatever they like.
    except Exception as error:
        raise CheckpointError(
            f"{path} must be a model that ONNX Runtime can run", got=first_line(error), remedy="export it anew"
        ) from error
    if run.names != list(manifest.inputs):
        raise CheckpointError(f"{path} must read {list(manifest.inputs)}", got=run.names, remedy="export it anew")
    return run, manifest


def run_by_openvino(path: Path) -> Run:
    """A model that `write` wrote, run by OpenVINO, which reads this format too."""
    import openvino

    return by_openvino.compile_model(openvino.Core().read_model(path), FP32)


def _refuse_dependencies(path: Path, model: Any) -> None:
    """Refuse operators and weights that are not in this file."""
    unknown = {each.domain for each in model.opset_import} - DOMAINS
    if unknown or len(model.functions) > 0:
        got = ", ".join(sorted(unknown)) or "functions of its own"
        raise CheckpointError(f"{path} must consist of ONNX's own operators", got=got, remedy="export it anew")
    if any(tensor.data_location != tensor.DEFAULT or tensor.external_data for tensor in _tensors(model.graph)):
        raise CheckpointError(f"{path} must hold its weights itself", got="other files", remedy="export it anew")


def _tensors(graph: Any) -> Iterator[Any]:
    """All tensors of a graph: weights, sparse weights, attributes of nodes, and those of inner graphs."""
    yield from graph.initializer
    for sparse in graph.sparse_initializer:
        yield from (sparse.values, sparse.indices)
    for node in graph.node:
        for attribute in node.attribute:
            yield from (attribute.t, *attribute.tensors)
            for inner in (attribute.g, *attribute.graphs):
                if inner.node or inner.initializer or inner.sparse_initializer:
                    yield from _tensors(inner)
