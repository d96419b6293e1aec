"""OpenVINO files: NAME.xml, the graph, and NAME.bin beside it, the weights.

Neither can run code, but the weights must be those of the graph: their SHA-256 stands in NAME.xml.
"""

import hashlib
import tempfile
from pathlib import Path
from typing import Any

from lfref.engines import by_openvino
from lfref.engines.engine import BF16, FP16, FP32, INT8, Run
from lfref.engines.files import as_onnx
from lfref.engines.files.manifest import KEY, Graph, Manifest, parse
from lfref.errors import CheckpointError
from lfref.io import atomic

PRECISIONS = (FP32, FP16, BF16, INT8)
"""fp16 weights are stored in half precision; bf16 is only said to the runtime."""
PACKAGES = (*by_openvino.PACKAGES, *as_onnx.PACKAGES)
WEIGHTS_KEY = "lfref_weights"
"""Key of the SHA-256 of the weights."""


def write(path: Path, graph: Graph, manifest: Manifest) -> None:
    """Write a model as `NAME.xml` and `NAME.bin`.

    Raises:
        FileError: The disk refuses.
    """
    import openvino

    with tempfile.TemporaryDirectory() as folder:
        # By way of ONNX, which knows free axes: what OpenVINO traces knows only the sizes of the trace.
        onnx_path = Path(folder, "model.onnx")
        onnx_path.write_bytes(as_onnx.to_model(graph).SerializeToString())
        model = openvino.convert_model(onnx_path)
    if manifest.precision == INT8:
        model = by_openvino.quantise(model, graph.patches)
    for port, (name, axes) in zip(model.inputs, graph.inputs.items(), strict=True):
        port.get_tensor().set_names({name})
        port.get_node().set_friendly_name(name)
        port.get_node().set_partial_shape(openvino.PartialShape([-1 if isinstance(n, str) else n for n in axes]))
    model.validate_nodes_and_infer_types()
    model.set_rt_info(manifest.text(), KEY)
    with tempfile.TemporaryDirectory() as folder:
        draft = Path(folder, "model.xml")
        for _ in range(2):  # the digest of the weights is known after the first time
            openvino.save_model(model, draft, compress_to_fp16=manifest.precision == FP16)
            model.set_rt_info(_digest(draft.with_suffix(".bin")), WEIGHTS_KEY)
        for suffix in (".bin", ".xml"):
            with atomic.replacing(path.with_suffix(suffix)) as partial:
                partial.write_bytes(draft.with_suffix(suffix).read_bytes())


def read(path: Path) -> tuple[Run, Manifest]:
    """A model that `write` wrote, ready to run, and its manifest.

    Raises:
        CheckpointError: Another file, its weights are missing or others, or this runtime cannot run it.
    """
    import openvino

    weights = path.with_suffix(".bin")
    if not weights.is_file():
        raise CheckpointError(f"{path} must have its weights beside it, {weights.name}", remedy="copy both")
    try:
        model = openvino.Core().read_model(path, weights)
        manifest, sha256 = parse(path, _metadata(model, KEY)), _metadata(model, WEIGHTS_KEY)
        if sha256 != _digest(weights):
            raise CheckpointError(f"{weights} must be the weights of {path.name}", got="others", remedy="copy both")
        precision = by_openvino.beside_int8() if manifest.precision == INT8 else manifest.precision
        run = by_openvino.compile_model(model, BF16 if precision == BF16 else FP32)
    except CheckpointError:
        raise
    # On a foreign file the library raises whatever it likes; its last line says most.
    except Exception as error:
        got = (str(error).strip() or type(error).__name__).splitlines()[-1][:200]
        raise CheckpointError(f"{path} must be a model of OpenVINO", got=got, remedy="export it anew") from error
    names = [port.get_any_name() for port in model.inputs]
    if names != list(manifest.inputs):
        raise CheckpointError(f"{path} must read {list(manifest.inputs)}", got=names, remedy="export it anew")
    return run, manifest


def _metadata(model: Any, key: str) -> str | None:
    return str(model.get_rt_info(key).astype(str)) if model.has_rt_info(key) else None


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
