"""OpenVINO files: NAME.xml, which says what is computed, and NAME.bin beside it, the weights.

Neither can run anything, but the one must be of the other: its SHA-256 stands in the first.
"""

import hashlib
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lfref.engines import by_openvino
from lfref.engines.engine import BF16, FP16, FP32, INT8, Run
from lfref.engines.files import as_onnx
from lfref.engines.files.manifest import KEY, Graph, Manifest, parsed
from lfref.errors import CheckpointError
from lfref.io import atomic

WEIGHTS = "lfref_weights"
"""Under which the SHA-256 of the other file stands."""


def write(path: Path, graph: Graph, manifest: Manifest) -> None:
    """Write a model.

    Args:
        path: The file, `NAME.xml`; its weights go to `NAME.bin`.
        graph: What it shall do.
        manifest: What it shall say of itself; its precision is one of `PRECISIONS`.

    Raises:
        FileError: The disk refuses.
    """
    import openvino

    model = PRECISIONS[manifest.precision](graph)
    for port, (name, axes) in zip(model.inputs, graph.inputs.items(), strict=True):
        port.get_tensor().set_names({name})
        port.get_node().set_friendly_name(name)
        port.get_node().set_partial_shape(openvino.PartialShape([-1 if isinstance(n, str) else n for n in axes]))
    model.validate_nodes_and_infer_types()
    model.set_rt_info(manifest.text(), KEY)
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder, "model.xml")
        for _ in range(2):  # the second time it knows its weights
            openvino.save_model(model, made, compress_to_fp16=manifest.precision == FP16)
            model.set_rt_info(_digest(made.with_suffix(".bin")), WEIGHTS)
        for suffix in (".bin", ".xml"):
            with atomic.replacing(path.with_suffix(suffix)) as partial:
                partial.write_bytes(made.with_suffix(suffix).read_bytes())


def opened(path: Path) -> tuple[Run, Manifest]:
    """A model, ready to run, and what it says of itself.

    Args:
        path: A file that `write` wrote.

    Raises:
        CheckpointError: Another file, its weights are missing or of another one, or this runtime cannot run it.
    """
    import openvino

    weights = path.with_suffix(".bin")
    if not weights.is_file():
        raise CheckpointError(f"{path} must have its weights beside it, {weights.name}", remedy="copy both")
    try:
        model = openvino.Core().read_model(path, weights)
        manifest, told = (parsed(path, _told(model, KEY)), _told(model, WEIGHTS))
        if told != _digest(weights):
            raise CheckpointError(f"{weights} must be the weights of {path.name}", got="others", remedy="copy both")
        run = by_openvino.compiled(model, _computed_in(manifest.precision))
    except CheckpointError:
        raise
    # Over a foreign file the library raises whatever it stumbles on.
    except Exception as error:
        got = (str(error).strip() or type(error).__name__).splitlines()[-1][:200]
        raise CheckpointError(f"{path} must be a model of OpenVINO", got=got, remedy="export it anew") from error
    names = [port.get_any_name() for port in model.inputs]
    if names != list(manifest.inputs):
        raise CheckpointError(f"{path} must read {list(manifest.inputs)}", got=names, remedy="export it anew")
    return run, manifest


def _plain(graph: Graph) -> Any:
    """By way of ONNX, which knows of free axes; what is traced knows but the sizes that it was traced with."""
    import openvino

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "model.onnx")
        path.write_bytes(as_onnx.model_of(graph).SerializeToString())
        return openvino.convert_model(path)


def _int8(graph: Graph) -> Any:
    return by_openvino.quantised(_plain(graph), graph.patches)


PRECISIONS: dict[str, Callable[[Graph], Any]] = {FP32: _plain, FP16: _plain, BF16: _plain, INT8: _int8}
"""Each (graph) -> model. Weights of fp16 are kept in half precision; bf16 and int8 are said to the runtime."""
PACKAGES = (*by_openvino.PACKAGES, *as_onnx.PACKAGES)


def _computed_in(precision: str) -> str:
    if precision == INT8:
        return by_openvino.around_int8()
    return BF16 if precision == BF16 else FP32


def _told(model: Any, key: str) -> str | None:
    return str(model.get_rt_info(key).astype(str)) if model.has_rt_info(key) else None


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
