"""ONNX files, which ONNX Runtime and other programs run.

Files are hostile input. Before a runtime sees a model, these are refused: operators that our networks do not need,
weights in other files, and weights that are not finite.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lfref.engines import by_onnxruntime, by_openvino
from lfref.engines.engine import FP16, FP32, INT8, NetworkFunction
from lfref.engines.files.manifest import KEY, STACK, Axes, Graph, Manifest, parse
from lfref.engines.files.network_copies import centred_norms, half_convolutions
from lfref.errors import CheckpointError, first_line
from lfref.io import atomic, tensor_files

PRECISIONS = (FP32, FP16, INT8)
"""Precisions of ONNX files; ONNX Runtime has no convolutions in bfloat16 on CPUs."""
PACKAGES = by_onnxruntime.PACKAGES
OPERATORS = {
    "Abs", "Add", "And", "AveragePool", "BatchNormalization", "Cast", "Ceil", "Clip", "Concat", "Conv", "Cos", "CumSum",
    "DepthToSpace", "DequantizeLinear", "Div", "Elu", "Equal", "Expand", "Floor", "Gather", "GatherElements",
    "Gelu", "Greater", "GreaterOrEqual", "HardSigmoid", "InstanceNormalization", "LeakyRelu", "Less", "LessOrEqual",
    "MatMul", "Max", "Min", "Mod", "Mul", "Neg", "Or", "Pad", "Pow", "QuantizeLinear", "Range", "Reciprocal",
    "ReduceMax", "ReduceMean", "ReduceMin", "ReduceSum", "Relu", "Reshape", "Round", "Shape", "Sigmoid", "Sign", "Sin",
    "Slice", "Softplus", "SpaceToDepth", "Split", "Sqrt", "Squeeze", "Sub", "TopK", "Transpose",
    "Unsqueeze", "Where",
}  # fmt: skip
"""Operators of ONNX that our networks and operators need: none of them repeats, branches, or reads files."""
NUMBERS = {1, 3, 6, 7, 9, 10, 11}
"""Types of weights and sizes, as ONNX numbers them: float32, int8, int32, int64, bool, float16, float64."""
LARGEST = 2**31
"""Largest size of an ONNX file in bytes."""


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
    for value, axes in zip(
        (*model.graph.input, *model.graph.output), (*graph.inputs.values(), graph.output), strict=True
    ):
        _name_axes(value, axes)
        value.doc_string = manifest.notes.get(value.name, "")
    model.producer_name, model.producer_version = "lfref", manifest.version
    # The manifest is one text; these entries are for people who look at the file.
    entries = {name: getattr(manifest, name) for name in ("version", "license", "samples", "encoding")}
    plain = {f"lfref_{name}": entry for name, entry in entries.items() if entry is not None}
    helper.set_model_props(model, {KEY: manifest.text(), "lfref_sha256": tensor_files.BLANK, **plain})
    with atomic.replacing(path) as partial:
        partial.write_bytes(model.SerializeToString())
        tensor_files.fill_digest(partial)


def to_model(graph: Graph) -> Any:
    """A graph as a model that runtimes compute as precisely as PyTorch does."""
    workload = replace(graph.workload, network=centred_norms(graph.module).eval())
    model = by_onnxruntime.export(workload, graph.free)
    # The exporter cannot name the output itself: a value inside the graph may have that name.
    (output,) = model.graph.output
    new = {STACK: f"{STACK}_inside"} | {output.name: STACK}
    for node in model.graph.node:
        for names in (node.input, node.output):
            names[:] = [new.get(name, name) for name in names]
    for value in (*model.graph.value_info, output):
        value.name = new.get(value.name, value.name)
    return model


def _name_axes(value: Any, axes: Axes) -> None:
    for place, axis in zip(value.type.tensor_type.shape.dim, axes, strict=True):
        if isinstance(axis, str):
            place.dim_param = axis
        else:
            place.dim_value = axis


def read(path: Path) -> tuple[NetworkFunction, Manifest]:
    """A model that `write` wrote, ready to run, and its manifest.

    Raises:
        CheckpointError: `write` did not write the file, or this runtime cannot run it.
    """
    import onnx

    try:
        if path.stat().st_size > LARGEST:
            raise CheckpointError(f"{path} must be smaller than 2 GiB", remedy="export it anew")
        has_digest = tensor_files.check_digest(path)
        content = path.read_bytes()
        model = onnx.load_model_from_string(content)
        _check(path, model)
        manifest = parse(path, {entry.key: entry.value for entry in model.metadata_props}.get(KEY), has_digest)
        run = by_onnxruntime.Session(content)
    except CheckpointError:
        raise
    # On a foreign file, the libraries raise any error.
    except Exception as error:
        raise CheckpointError(
            f"{path} must be a model that ONNX Runtime can run", got=first_line(error), remedy="export it anew"
        ) from error
    if run.names != list(manifest.inputs):
        raise CheckpointError(f"{path} must read {list(manifest.inputs)}", got=run.names, remedy="export it anew")
    return run, manifest


def run_by_openvino(path: Path) -> NetworkFunction:
    """A model that `write` wrote, ready to run by OpenVINO, which also reads this format."""
    import openvino

    return by_openvino.compile_model(openvino.Core().read_model(path), FP32)


def _check(path: Path, model: Any) -> None:
    """Refuse a model that does more than compute, lacks its weights, or has weights that are not finite."""
    import onnx
    from onnx import numpy_helper

    def refuse(expected: str, got: object) -> None:
        raise CheckpointError(f"{path} must {expected}", got=got, remedy="export it anew")

    graph, scalars = model.graph, onnx.AttributeProto
    kinds = {scalars.FLOAT, scalars.INT, scalars.STRING, scalars.INTS}
    if others := {opset.domain for opset in model.opset_import} - {""}:
        refuse("consist of ONNX's own operators", ", ".join(sorted(others)))
    if model.functions or model.training_info or graph.sparse_initializer:
        refuse("be one plain graph", "functions or sparse weights")
    for node in graph.node:
        if node.domain or node.op_type not in OPERATORS:
            refuse("consist of the operators of lfref's networks", f"{node.domain} {node.op_type}".strip()[:80])
        # Attributes of other kinds are graphs, tensors and types.
        if any(attribute.type not in kinds or attribute.ref_attr_name for attribute in node.attribute):
            refuse("give operators numbers and texts only", node.op_type)
    for tensor in graph.initializer:
        if tensor.data_location != tensor.DEFAULT or tensor.external_data:
            refuse("hold its weights itself", "other files")
        if tensor.data_type not in NUMBERS or not np.isfinite(numpy_helper.to_array(tensor)).all():
            refuse("hold finite weights", tensor.name[:80])
