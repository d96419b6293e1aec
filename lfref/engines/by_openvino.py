"""OpenVINO on the CPU, in float32, bfloat16 or int8, which NNCF calibrates on patches.

On some processors OpenVINO computes in bfloat16 by default, so the precision is always set.

Its CPU plugin gives the calling thread another stack for handlers of signals, and frees that stack when its last model
is deleted, by whichever thread. Python's handlers (Ctrl+C, or a child process that ends while a data loader has
workers) would then run in freed memory, and the process would die without a word: `own_signal_stack` keeps Python's.
"""

import contextlib
import ctypes
import functools
import sys
from collections.abc import Iterator, Sequence
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


class _Stack(ctypes.Structure):
    """`stack_t` of the C library on Linux: a thread's stack for handlers of signals."""

    _fields_ = (("start", ctypes.c_void_p), ("flags", ctypes.c_int), ("size", ctypes.c_size_t))


@contextlib.contextmanager
def own_signal_stack() -> Iterator[None]:
    """Give this thread its stack for handlers of signals back at the end, on Linux."""
    if not sys.platform.startswith("linux"):
        yield
        return
    exchange, before = ctypes.CDLL(None).sigaltstack, _Stack()
    exchange(None, ctypes.byref(before))
    try:
        yield
    finally:
        exchange(ctypes.byref(before), None)


@own_signal_stack()
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


@own_signal_stack()
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


@own_signal_stack()
def has_bf16() -> bool:
    """Whether the processor computes in bfloat16; on others OpenVINO computes in float32, and does not say so."""
    import openvino

    return "BF16" in openvino.Core().get_property("CPU", "OPTIMIZATION_CAPABILITIES")


def beside_int8() -> str:
    """Precision of the parts that are not in int8: bfloat16 if the processor has it."""
    return BF16 if has_bf16() else FP32


@own_signal_stack()
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
        is_able=has_bf16 if precision == BF16 else None,
    )
    for precision in (FP32, BF16, INT8)
}
