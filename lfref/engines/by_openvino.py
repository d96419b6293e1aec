"""OpenVINO on the CPU, in float32, bfloat16 or int8, which NNCF calibrates on patches.

On some processors OpenVINO computes in bfloat16 by default, so the precision is always set.
"""

import functools
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from lfref.engines.engine import (
    BF16,
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

Model = Any
"""A model of OpenVINO; its type is known only where the package is installed."""
HINTS = {FP32: "f32", BF16: "bf16"}
NOT_COMPUTING = {"Convolution", "Parameter", "Constant", "Result"}
"""Types of nodes that need not be kept out of int8: convolutions, and nodes that compute nothing."""


def prepare(workload: EngineWorkload, precision: str) -> NetworkFunction:
    """The network in a precision; under int8, all but the inner convolutions have the precision of `beside_int8`."""
    import openvino

    # Tracing warns that Python code reads shapes; all inputs have these shapes.
    with quiet():
        model = openvino.convert_model(workload.network, example_input=workload.small)
    if precision == INT8:
        model, precision = quantise(model, workload.patches), beside_int8()
    model.reshape({port: list(images.shape) for port, images in zip(model.inputs, workload.example, strict=True)})
    return compile_model(model, precision)


def quantise(model: Model, patches: Sequence[Inputs]) -> Model:
    """A model with inner convolutions in int8, calibrated on patches."""
    import nncf

    nodes = model.get_ordered_ops()
    kernels = {
        node.get_friendly_name(): tuple(node.input_value(1).get_partial_shape().to_shape())[2:]
        for node in nodes
        if node.get_type_name() == "Convolution"
    }
    # Sums and normalisations in 8 bits cost far more accuracy than they save time.
    others = {node.get_type_name() for node in nodes} - NOT_COMPUTING
    ignored = nncf.IgnoredScope(names=float_convolutions(kernels), types=sorted(others), validate=False)
    with quiet():
        return nncf.quantize(
            model,
            nncf.Dataset([arrays(patch) for patch in patches]),
            preset=nncf.QuantizationPreset.MIXED,
            subset_size=len(patches),
            ignored_scope=ignored,
        )


def beside_int8() -> str:
    """Precision of the parts that are not in int8: bfloat16 if the processor has it."""
    import openvino

    return BF16 if "BF16" in openvino.Core().get_property("CPU", "OPTIMIZATION_CAPABILITIES") else FP32


def compile_model(model: Model, precision: str) -> NetworkFunction:
    """A model, ready to run in a precision, a key of `HINTS`."""
    import openvino

    options = {
        "INFERENCE_PRECISION_HINT": HINTS[precision],
        "INFERENCE_NUM_THREADS": torch.get_num_threads(),
        "PERFORMANCE_HINT": "LATENCY",
    }
    compiled = openvino.Core().compile_model(model, "CPU", options)

    def run(*inputs: Tensor) -> Tensor:
        return torch.from_numpy(compiled(arrays(inputs), share_inputs=True)[0])

    return run


PACKAGES = ("openvino",)
PREPARATIONS = {
    precision: Preparation(
        functools.partial(prepare, precision=precision),
        (*PACKAGES, "nncf") if precision == INT8 else PACKAGES,
        ("cpu",),
    )
    for precision in (FP32, BF16, INT8)
}
