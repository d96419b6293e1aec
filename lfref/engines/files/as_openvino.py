"""OpenVINO files: NAME.xml, the graph, and NAME.bin beside it, the weights.

NAME.xml holds the SHA-256 of both files. Graphs are hostile input: layers that our networks do not need are refused
before OpenVINO sees them. Each format has its own module.
"""

import hashlib
import re
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from lfref.engines import by_openvino
from lfref.engines.engine import BF16, FP16, FP32, INT8, NetworkFunction
from lfref.engines.files import as_onnx
from lfref.engines.files.manifest import KEY, STACK, Graph, Manifest, parse
from lfref.engines.files.network_copies import half_convolutions
from lfref.errors import CheckpointError
from lfref.io import atomic, tensor_files

PRECISIONS = (FP32, FP16, BF16, INT8)
"""Precisions of OpenVINO files: fp16 stores weights in half precision; in bf16 convolutions have that type too."""
PACKAGES = (*by_openvino.PACKAGES, *as_onnx.PACKAGES)
DIGEST_KEY, FORMER_KEY = "lfref_digest", "lfref_weights"
"""Key of the SHA-256 of both files, and the key of earlier versions, for the SHA-256 of the weights alone."""
LAYERS = {
    "Abs", "Add", "AvgPool", "Broadcast", "Ceiling", "Clamp", "Concat", "Const", "Convert", "Convolution", "Cos",
    "CumSum", "DepthToSpace", "Divide", "Elu", "Equal", "Exp", "FakeQuantize", "Floor", "FloorMod", "Gather",
    "GatherElements", "Gelu", "Greater", "GreaterEqual", "GroupConvolution", "HardSigmoid", "Less", "LessEqual", "Log",
    "LogicalAnd", "LogicalOr", "MVN", "MatMul", "Maximum", "Minimum", "Multiply", "Negative", "PReLU", "Pad",
    "Parameter", "Power", "Range", "ReLU", "ReduceMax", "ReduceMean", "ReduceMin", "ReduceSum", "Reshape", "Result",
    "Round", "Select", "ShapeOf", "Sigmoid", "Sign", "Sin", "Slice", "SoftMax", "SoftPlus", "SpaceToDepth", "Split",
    "Sqrt", "Squeeze", "Subtract", "Swish", "Tanh", "TopK", "Transpose", "Unsqueeze", "VariadicSplit",
}  # fmt: skip
"""Layers that our networks and operators need: none of them repeats, branches, or keeps a state."""
LARGEST = 2**26
"""Largest size of NAME.xml in bytes."""


def write(path: Path, graph: Graph, manifest: Manifest) -> None:
    """Write a model as `NAME.xml` and `NAME.bin`.

    Raises:
        FileError: The disk refuses.
    """
    import openvino

    if manifest.precision == BF16:
        graph = replace(graph, module=half_convolutions(graph.module, BF16))
    with tempfile.TemporaryDirectory() as folder:
        # The model goes through ONNX, which knows free axes: a trace of OpenVINO knows only the sizes of its inputs.
        onnx_path = Path(folder, "model.onnx")
        onnx_path.write_bytes(as_onnx.to_model(graph).SerializeToString())
        model = openvino.convert_model(onnx_path)
    if manifest.precision == INT8:
        model = by_openvino.quantise(model, graph.patches)
    for port, (name, axes) in zip(model.inputs, graph.inputs.items(), strict=True):
        port.get_tensor().set_names({name})
        port.get_node().set_friendly_name(name)
        port.get_node().set_partial_shape(openvino.PartialShape([-1 if isinstance(n, str) else n for n in axes]))
    model.output(0).get_tensor().set_names({STACK})
    model.validate_nodes_and_infer_types()
    model.set_rt_info(manifest.text(), KEY)
    model.set_rt_info(tensor_files.BLANK, DIGEST_KEY)
    with tempfile.TemporaryDirectory() as folder:
        draft = Path(folder, "model.xml")
        openvino.save_model(model, draft, compress_to_fp16=manifest.precision == FP16)
        tensor_files.fill_digest(draft, draft.with_suffix(".bin"))
        for suffix in (".bin", ".xml"):
            with atomic.replacing(path.with_suffix(suffix)) as partial:
                partial.write_bytes(draft.with_suffix(suffix).read_bytes())


def read(path: Path) -> tuple[NetworkFunction, Manifest]:
    """A model that `write` wrote, ready to run, and its manifest.

    Raises:
        CheckpointError: `write` did not write the file, its weights are missing or belong to another model, or this
            runtime cannot run it.
    """
    import openvino

    weights = path.with_suffix(".bin")
    if not weights.is_file():
        raise CheckpointError(f"{path} must have its weights beside it, {weights.name}", remedy="copy both")
    try:
        has_digest = tensor_files.check_digest(path, weights)
        _check(path)
        model = openvino.Core().read_model(path, weights)
        manifest = parse(path, _metadata(model, KEY), has_digest)
        if not has_digest and _metadata(model, FORMER_KEY) != hashlib.sha256(weights.read_bytes()).hexdigest():
            raise CheckpointError(f"{weights} must be the weights of {path.name}", got="others", remedy="copy both")
        for layer in model.get_ordered_ops():
            if layer.get_type_name() == "Constant" and not np.isfinite(layer.data).all():
                got = layer.get_friendly_name()[:80]
                raise CheckpointError(f"{weights} must hold finite weights", got=got, remedy="export it anew")
        names = [port.get_any_name() for port in model.inputs]
        precision = by_openvino.beside_int8() if manifest.precision == INT8 else manifest.precision
        run = by_openvino.compile_model(model, BF16 if precision == BF16 else FP32)
    except CheckpointError:
        raise
    # On a foreign file the library raises any error; its last line says most.
    except Exception as error:
        got = (str(error).strip() or type(error).__name__).splitlines()[-1][:200]
        raise CheckpointError(f"{path} must be a model of OpenVINO", got=got, remedy="export it anew") from error
    if names != list(manifest.inputs):
        raise CheckpointError(f"{path} must read {list(manifest.inputs)}", got=names, remedy="export it anew")
    return run, manifest


def _check(path: Path) -> None:
    """Refuse layers that no network of ours has, and XML that grows when it is read."""
    text = path.read_bytes()
    if len(text) > LARGEST or b"<!" in text or b"\0" in text:
        raise CheckpointError(f"{path} must be a plain graph", got="declarations, or 64 MiB", remedy="export it anew")
    for layer in ElementTree.fromstring(text).iter("layer"):
        kind, version = str(layer.get("type")), str(layer.get("version"))
        if kind not in LAYERS or not re.fullmatch(r"opset\d{1,2}", version):
            got = f"{kind} of {version}"[:80]
            raise CheckpointError(
                f"{path} must consist of the layers of lfref's networks", got=got, remedy="export it anew"
            )


def _metadata(model: Any, key: str) -> str | None:
    return str(model.get_rt_info(key).astype(str)) if model.has_rt_info(key) else None
