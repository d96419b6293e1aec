"""OpenVINO on the CPU. Its whole numbers are scaled by NNCF, on patches.

On some processors OpenVINO computes in bfloat16 unless it is told otherwise: the precision is always told.
"""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from lfref.engines.engine import BF16, FP32, INT8, Inputs, Job, Run, Way, hushed, left_in_float

CONVOLUTION = "Convolution"
ENDS = ("Parameter", "Constant", "Result")
"""Nodes of a model that compute nothing."""
Model = Any
"""OpenVINO's own; its type is known only where it is installed."""


HINTS = {FP32: "f32", BF16: "bf16"}


def fp32(job: Job) -> Run:
    """The network in float32."""
    return _compiled(job, converted(job), FP32)


def bf16(job: Job) -> Run:
    """The network, and all that lies between its layers, in bfloat16."""
    return _compiled(job, converted(job), BF16)


def int8(job: Job) -> Run:
    """The network with inner convolutions of whole numbers, the rest in bfloat16 where the processor has it."""
    return _compiled(job, quantised(converted(job), job.patches), around_int8())


def quantised(model: Model, patches: Sequence[Inputs]) -> Model:
    """A model whose inner convolutions are of whole numbers.

    Args:
        model: Of `converted`.
        patches: By which they are scaled.
    """
    import nncf

    nodes = model.get_ordered_ops()
    kernels = {
        each.get_friendly_name(): tuple(each.input_value(1).get_partial_shape().to_shape())[2:]
        for each in nodes
        if each.get_type_name() == CONVOLUTION
    }
    # Sums and normalisations of 8 bits cost a network far more than they save.
    others = {each.get_type_name() for each in nodes} - {CONVOLUTION, *ENDS}
    left_out = nncf.IgnoredScope(names=left_in_float(kernels), types=sorted(others), validate=False)
    with hushed():
        return nncf.quantize(
            model,
            nncf.Dataset([_arrays(patch) for patch in patches]),
            preset=nncf.QuantizationPreset.MIXED,
            subset_size=len(patches),
            ignored_scope=left_out,
        )


def around_int8() -> str:
    """Precision of what is not of whole numbers: the fastest of this processor."""
    import openvino

    return BF16 if "BF16" in openvino.Core().get_property("CPU", "OPTIMIZATION_CAPABILITIES") else FP32


def converted(job: Job) -> Model:
    """The network as OpenVINO's model of any size."""
    import openvino

    # Shapes that Python looks at are those of all inputs of a job: no warning is worth reading.
    with hushed():
        return openvino.convert_model(job.network, example_input=job.small)


def _compiled(job: Job, model: Model, precision: str) -> Run:
    model.reshape({port: list(each.shape) for port, each in zip(model.inputs, job.example, strict=True)})
    return compiled(model, precision)


def compiled(model: Model, precision: str) -> Run:
    """A model, ready to run.

    Args:
        model: Of the shapes that it will be given.
        precision: A key of `HINTS`.
    """
    import openvino

    options = {
        "INFERENCE_PRECISION_HINT": HINTS[precision],
        "INFERENCE_NUM_THREADS": torch.get_num_threads(),
        "PERFORMANCE_HINT": "LATENCY",
    }
    return _on_tensors(openvino.Core().compile_model(model, "CPU", options))


def _on_tensors(model: Callable[..., Any]) -> Run:
    def run(*inputs: Tensor) -> Tensor:
        return torch.from_numpy(model(_arrays(inputs), share_inputs=True)[0])

    return run


def _arrays(inputs: Inputs) -> list[Any]:
    return [each.contiguous().numpy() for each in inputs]


PACKAGES, DEVICES = ("openvino",), ("cpu",)
WAYS = {
    FP32: Way(fp32, PACKAGES, DEVICES),
    BF16: Way(bf16, PACKAGES, DEVICES),
    INT8: Way(int8, (*PACKAGES, "nncf"), DEVICES),
}
