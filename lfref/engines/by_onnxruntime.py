"""ONNX Runtime on the CPU, in float32 or in int8 that is calibrated on patches."""

import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from lfref.engines.engine import (
    FP32,
    INT8,
    EngineWorkload,
    Inputs,
    NetworkFunction,
    Preparation,
    arrays,
    float_convolutions,
    quiet,
)

FATAL_ONLY = 4
"""Level at which ONNX Runtime logs fatal errors only: it also raises all errors, which become one line."""


def fp32(workload: EngineWorkload) -> NetworkFunction:
    """The network in float32."""
    return Session(export(workload).SerializeToString())


def int8(workload: EngineWorkload) -> NetworkFunction:
    """The network with inner convolutions in int8, with a scale for each filter, and the rest in float32."""
    return Session(quantise(export(workload), workload.patches).SerializeToString())


def export(workload: EngineWorkload, free: Sequence[Iterable[int]] | None = None) -> Any:
    """The network as an ONNX model that reads any number of pixels: one model reads patches and pictures.

    Args:
        workload: The network; the example gives the lengths of all other axes.
        free: Places of the axes of each input that may have any length; None: rows and columns of pixels.
    """
    places = [(images.ndim - 2, images.ndim - 1) for images in workload.example] if free is None else free
    axes = tuple(dict.fromkeys(of_input, torch.export.Dim.DYNAMIC) for of_input in places)
    with quiet():
        program = torch.onnx.export(
            workload.network, workload.example, dynamo=True, dynamic_shapes=axes, verbose=False, optimize=False
        )
        assert program is not None
        _simplify(program.model)
    model = program.model_proto
    # Remove the exporter's notes: stack traces with paths of this machine, and names of Python objects.
    parts = (model.graph, *model.graph.node, *model.graph.initializer, *model.graph.value_info)
    for part in (*parts, *model.graph.input, *model.graph.output):
        part.ClearField("metadata_props")
        part.ClearField("doc_string")
    return model


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


def quantise(model: Any, patches: Sequence[Inputs]) -> Any:
    """A model of `export` with inner convolutions in int8, calibrated on patches."""
    import onnx
    from onnxruntime import quantization

    names = [value.name for value in model.graph.input]
    feeds = iter([dict(zip(names, arrays(patch), strict=True)) for patch in patches])

    class CalibrationReader:
        def get_next(self) -> dict[str, Any] | None:
            return next(feeds, None)

    shapes = {weight.name: tuple(weight.dims) for weight in model.graph.initializer}
    kernels = {node.name: shapes[node.input[1]][2:] for node in model.graph.node if node.op_type == "Conv"}
    with quiet(), tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "int8.onnx")
        quantization.quantize_static(
            model,
            str(path),
            CalibrationReader(),
            op_types_to_quantize=["Conv"],
            nodes_to_exclude=float_convolutions(kernels),
            per_channel=True,
        )
        return onnx.load_model(path)


class Session:
    """A serialised model, ready to run."""

    def __init__(self, model: bytes) -> None:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = torch.get_num_threads()
        options.log_severity_level = FATAL_ONLY
        # For some damaged models, the package prints several lines before it raises an error.
        with quiet():
            self.runtime = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
        self.names = [value.name for value in self.runtime.get_inputs()]

    def __call__(self, *inputs: Tensor) -> Tensor:
        """Run the model."""
        (stack,) = self.runtime.run(None, dict(zip(self.names, arrays(inputs), strict=True)))
        return torch.from_numpy(stack)


PACKAGES = ("onnx", "onnxscript", "onnxruntime")
PREPARATIONS = {FP32: Preparation(fp32, PACKAGES, ("cpu",)), INT8: Preparation(int8, PACKAGES, ("cpu",))}
