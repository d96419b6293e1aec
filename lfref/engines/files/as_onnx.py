"""ONNX files: run by ONNX Runtime, and by whatever else reads them.

Whoever sends a model chooses what it says. Weights that lie in other files, and operators that come with libraries, are
refused before a runtime sees it.
"""

import copy
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from torch import Tensor, nn

from lfref.engines import by_onnxruntime
from lfref.engines import by_openvino as runtime
from lfref.engines.engine import FP16, FP32, INT8, Job, Run
from lfref.engines.files.manifest import KEY, Axes, Graph, Manifest, lowered, parsed
from lfref.errors import CheckpointError, first_line
from lfref.io import atomic

# PART centred
# Networks whose normalisations read what has a mean of nearly 0 already, so that it does not matter how one is taken.
#
# Of frames that are flat, runtimes that add up in float32 make a mean that is off by more than what varies: pictures
# of a
# small RefNet were off by .008 in OpenVINO, of the one of 12.5 million weights by .15 in ONNX Runtime.


class Centred(nn.Module):
    """A normalisation, after the mean was taken off.

    Args:
        norm: What is made the same by.
    """

    def __init__(self, norm: nn.InstanceNorm2d | nn.GroupNorm) -> None:
        super().__init__()
        self.norm = norm
        self.n_groups = norm.num_groups if isinstance(norm, nn.GroupNorm) else norm.num_features

    def forward(self, features: Tensor) -> Tensor:
        """Normalise."""
        grouped = features.unflatten(1, (self.n_groups, -1))
        made: Tensor = self.norm((grouped - grouped.mean((2, 3, 4), keepdim=True)).flatten(1, 2))
        return made


def centred(module: nn.Module) -> nn.Module:
    """A copy that normalises so.

    Args:
        module: Left as it is.
    """
    return _replaced(copy.deepcopy(module))


def _replaced(module: nn.Module) -> nn.Module:
    if isinstance(module, nn.InstanceNorm2d | nn.GroupNorm):
        return Centred(module)
    for name, child in module.named_children():
        setattr(module, name, _replaced(child))
    return module


DOMAINS = ("", "ai.onnx", "com.microsoft")
"""Whose operators runtimes have themselves."""
LARGEST = 2**31
"""Bytes that a message of this kind may have."""


def write(path: Path, graph: Graph, manifest: Manifest) -> None:
    """Write a model.

    Args:
        path: The file, `NAME.onnx`.
        graph: What it shall do.
        manifest: What it shall say of itself; its precision is one of `PRECISIONS`.

    Raises:
        FileError: The disk refuses.
    """
    from onnx import helper

    model = PRECISIONS[manifest.precision](graph)
    for values, all_axes in ((model.graph.input, graph.inputs.values()), (model.graph.output, [graph.output])):
        for value, axes in zip(values, all_axes, strict=True):
            _name_axes(value, axes)
    helper.set_model_props(model, {KEY: manifest.text()})
    with atomic.replacing(path) as partial:
        partial.write_bytes(model.SerializeToString())


def opened(path: Path) -> tuple[Run, Manifest]:
    """A model, ready to run, and what it says of itself.

    Args:
        path: A file that `write` wrote.

    Raises:
        CheckpointError: Another file, or one that this runtime cannot run.
    """
    import onnx

    try:
        if path.stat().st_size > LARGEST:
            raise CheckpointError(f"{path} must be smaller than 2 GiB", remedy="export it anew")
        content = path.read_bytes()
        model = onnx.load_model_from_string(content)
        _check(path, model)
        manifest = parsed(path, {each.key: each.value for each in model.metadata_props}.get(KEY))
        run = by_onnxruntime.Session(content)
    except CheckpointError:
        raise
    # Over a foreign file the libraries raise whatever they stumble on.
    except Exception as error:
        raise CheckpointError(
            f"{path} must be a model that ONNX Runtime can run", got=first_line(error), remedy="export it anew"
        ) from error
    if run.names != list(manifest.inputs):
        raise CheckpointError(f"{path} must read {list(manifest.inputs)}", got=run.names, remedy="export it anew")
    return run, manifest


def by_openvino(path: Path) -> Run:
    """A model that `write` wrote, run by OpenVINO, which reads this format too.

    Args:
        path: The file.
    """
    import openvino

    return runtime.compiled(openvino.Core().read_model(path), FP32)


def model_of(graph: Graph) -> Any:
    """A graph as a model that runtimes compute as precisely as PyTorch.

    Args:
        graph: What it shall do.
    """
    return by_onnxruntime.exported(Job(centred(graph.module).eval(), graph.example), graph.free)


def _fp16(graph: Graph) -> Any:
    return model_of(replace(graph, module=lowered(graph.module, FP16)))


def _int8(graph: Graph) -> Any:
    return by_onnxruntime.quantised(model_of(graph), graph.patches)


PRECISIONS = {FP32: model_of, FP16: _fp16, INT8: _int8}
"""Each (graph) -> model. ONNX Runtime has no convolutions of bfloat16 on CPUs."""
PACKAGES = by_onnxruntime.PACKAGES


def _name_axes(value: Any, axes: Axes) -> None:
    """Call the free axes of an input or output by their letters."""
    for place, axis in zip(value.type.tensor_type.shape.dim, axes, strict=True):
        if isinstance(axis, str):
            place.dim_param = axis
        else:
            place.dim_value = axis


def _check(path: Path, model: Any) -> None:
    """Refuse what is not all in this file."""
    unknown = {each.domain for each in model.opset_import} - {*DOMAINS}
    if unknown or len(model.functions) > 0:
        got = ", ".join(sorted(unknown)) or "functions of its own"
        raise CheckpointError(f"{path} must consist of ONNX's own operators", got=got, remedy="export it anew")
    if any(tensor.data_location != tensor.DEFAULT or tensor.external_data for tensor in _tensors(model.graph)):
        raise CheckpointError(f"{path} must hold its weights itself", got="other files", remedy="export it anew")


def _tensors(graph: Any) -> Iterator[Any]:
    yield from graph.initializer
    for sparse in graph.sparse_initializer:
        yield from (sparse.values, sparse.indices)
    for node in graph.node:
        for attribute in node.attribute:
            yield from (attribute.t, *attribute.tensors)
            for inner in (attribute.g, *attribute.graphs):
                if inner.node or inner.initializer or inner.sparse_initializer:
                    yield from _tensors(inner)
