"""ONNX Runtime on the CPU, which computes in float32, or in whole numbers that it scales on patches.

A model is exported with any number of pixels, so that patches and pictures are read by one.
"""

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from lfref.engines.engine import FP32, INT8, Inputs, Job, Run, Way, hushed, left_in_float

CONVOLUTION = "Conv"
QUIET = 3
"""ONNX Runtime's level of errors."""


def fp32(job: Job) -> Run:
    """The network in float32."""
    return Session(exported(job).SerializeToString())


def int8(job: Job) -> Run:
    """The network with inner convolutions of whole numbers, a scale for each of their filters, the rest in float32."""
    return Session(quantised(exported(job), job.patches).SerializeToString())


def quantised(model: Any, patches: Sequence[Inputs]) -> Any:
    """A model whose inner convolutions are of whole numbers.

    Args:
        model: Of `exported`.
        patches: By which they are scaled.
    """
    import onnx
    from onnxruntime import quantization

    weights = {each.name: tuple(each.dims) for each in model.graph.initializer}
    kernels = {each.name: weights[each.input[1]][2:] for each in model.graph.node if each.op_type == CONVOLUTION}
    with hushed(), tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "int8.onnx")
        quantization.quantize_static(
            model,
            str(path),
            _Patches(model, patches),
            op_types_to_quantize=[CONVOLUTION],
            nodes_to_exclude=left_in_float(kernels),
            per_channel=True,
        )
        return onnx.load_model(path)


def exported(job: Job, free: Sequence[Iterable[int]] | None = None) -> Any:
    """The network as an ONNX model that reads any number of pixels.

    Args:
        job: Its example gives all other axes.
        free: Places of the axes of each input that may have any length; None: rows and columns of pixels.
    """
    places = [(each.ndim - 2, each.ndim - 1) for each in job.example] if free is None else free
    axes = tuple(dict.fromkeys(of_input, torch.export.Dim.DYNAMIC) for of_input in places)
    with hushed():
        program = torch.onnx.export(job.network, job.example, dynamo=True, dynamic_shapes=axes, verbose=False)
    assert program is not None
    return program.model_proto


class _Patches:
    """Patches as ONNX Runtime asks for them, one after the other, then None."""

    def __init__(self, model: Any, patches: Sequence[Inputs]) -> None:
        names = [each.name for each in model.graph.input]
        self.waiting: Iterator[dict[str, Any]] = (dict(zip(names, _arrays(patch), strict=True)) for patch in patches)

    def get_next(self) -> dict[str, Any] | None:
        """The next patch by the names of the model's inputs."""
        return next(self.waiting, None)


class Session:
    """A model that is ready to run."""

    def __init__(self, model: bytes) -> None:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = torch.get_num_threads()
        options.log_severity_level = QUIET
        self.runtime = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
        self.names = [each.name for each in self.runtime.get_inputs()]

    def __call__(self, *inputs: Tensor) -> Tensor:
        """Run it."""
        (stack,) = self.runtime.run(None, dict(zip(self.names, _arrays(inputs), strict=True)))
        return torch.from_numpy(stack)


def _arrays(inputs: Inputs) -> list[Any]:
    return [each.contiguous().numpy() for each in inputs]


PACKAGES, DEVICES = ("onnx", "onnxscript", "onnxruntime"), ("cpu",)
WAYS = {FP32: Way(fp32, PACKAGES, DEVICES), INT8: Way(int8, PACKAGES, DEVICES)}
