"""The table of engines, and the engines of PyTorch itself: eager, channels last, compiled, CUDA graphs.

A CUDA graph records the GPU's commands of one pass and replays them, so that the CPU need not issue them (PyTorch,
"CUDA semantics", section "CUDA Graphs").
The module stands apart from the benchmark that compares the engines, since each engine is useful alone.
"""

import copy
import functools
from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor, nn

from lfref.engines import by_onnxruntime, by_openvino
from lfref.engines.engine import BF16, FP32, INT8, EngineWorkload, Inputs, NetworkFunction, Preparation
from lfref.errors import InputError, chosen

COMPILERS = ("g++", "clang++", "c++")
WARMUP = 3
"""Number of passes before a CUDA graph is recorded: in them, libraries choose their algorithms."""


def prepare(engine: str, precision: str, workload: EngineWorkload) -> NetworkFunction:
    """Prepare a network for an engine.

    Args:
        engine: A key of `ENGINES`.
        precision: `fp32`, `bf16` or `int8`.
        workload: The network and its inputs; for `int8` with patches.

    Returns:
        A function that is called like the network, and returns the same without gradients.

    Raises:
        InputError: There is no such engine or precision, a package or program is missing, or the workload does not
            fit.

    Example:
        >>> workload = EngineWorkload(torch.nn.Conv2d(3, 8, 3).eval(), (torch.rand(1, 3, 16, 16),))
        >>> prepare("channels_last", "bf16", workload)(torch.rand(1, 3, 16, 16)).shape
        torch.Size([1, 8, 14, 14])
    """
    preparation = chosen(f"precision of engine {engine}", precision, chosen("engine", engine, ENGINES))
    if (lacking := preparation.lacking(workload.device)) is not None:
        raise lacking
    if workload.network.training:
        raise InputError("the network must be in evaluation mode", got="training mode", remedy="call network.eval()")
    if precision == INT8 and not workload.patches:
        raise InputError(
            "int8 needs inputs to be calibrated by", got="no patches", remedy="give EngineWorkload(patches=...)"
        )
    with torch.no_grad():
        run = preparation.prepare(workload)
    expected = _types(workload.example)

    @torch.no_grad()
    def checked(*inputs: Tensor) -> Tensor:
        if (got := _types(inputs)) != expected:
            remedy = "prepare it for inputs like these"
            raise InputError(f"this engine was prepared for {', '.join(expected)}", got=", ".join(got), remedy=remedy)
        return run(*inputs)

    return checked


def _types(inputs: Inputs) -> list[str]:
    return [f"{'x'.join(map(str, tensor.shape))} {str(tensor.dtype).removeprefix('torch.')}" for tensor in inputs]


def _eager(workload: EngineWorkload, precision: str) -> NetworkFunction:
    """The network by PyTorch, operation by operation; the other engines are compared with it."""
    return _in_bf16(workload.network) if precision == BF16 else workload.network


def _channels_last(workload: EngineWorkload, precision: str) -> NetworkFunction:
    """The network as by `_eager`, with the channels of a pixel side by side in memory."""
    network: nn.Module = copy.deepcopy(workload.network)
    network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return _in_bf16(network) if precision == BF16 else network


def _compile(workload: EngineWorkload, precision: str) -> NetworkFunction:
    """The network compiled by Inductor: fused loops between convolutions, weights as constants in a fast order."""
    run = _channels_last(workload, precision)

    def alone(*inputs: Tensor) -> Tensor:
        return run(*inputs)

    # PyTorch counts compilations by code object, and silently stops after a few: each function gets its own object.
    alone.__code__ = alone.__code__.replace()
    return torch.compile(alone, dynamic=False, options={"freezing": True})


def _cuda_graph(workload: EngineWorkload, precision: str) -> NetworkFunction:
    """The network as a CUDA graph: a recorded pass."""
    run = _channels_last(workload, precision)
    # A graph reads and writes the memory with which it was recorded.
    inputs = tuple(tensor.clone() for tensor in workload.example)
    stream = torch.cuda.Stream(workload.device)
    stream.wait_stream(torch.cuda.current_stream(workload.device))
    with torch.cuda.stream(stream):
        for _ in range(WARMUP):
            run(*inputs)
    torch.cuda.current_stream(workload.device).wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    # Graphs record the current device.
    with torch.cuda.device(workload.device), torch.cuda.graph(graph):
        stack = run(*inputs)

    # `run` is bound here: the graph reads its weights at their old addresses, so they must stay in memory.
    def replay(*new: Tensor, network: NetworkFunction = run) -> Tensor:
        for memory, tensor in zip(inputs, new, strict=True):
            memory.copy_(tensor)
        graph.replay()
        return stack.clone()

    return replay


def _in_bf16(run: NetworkFunction) -> NetworkFunction:
    """PyTorch's operations with convolutions and products in bfloat16, the result in the type of the first input."""

    def half(*inputs: Tensor) -> Tensor:
        # Weights that autocast converts and keeps would dangle where a CUDA graph is replayed.
        with torch.autocast(inputs[0].device.type, torch.bfloat16, cache_enabled=False):
            stack = run(*inputs)
        return stack.to(inputs[0].dtype)

    return half


def _both(function: Callable[..., NetworkFunction], **needs: Any) -> Mapping[str, Preparation]:
    """An engine of PyTorch in float32 and bfloat16."""
    return {
        precision: Preparation(functools.partial(function, precision=precision), **needs) for precision in (FP32, BF16)
    }


ENGINES: dict[str, Mapping[str, Preparation]] = {
    "eager": _both(_eager),
    "channels_last": _both(_channels_last),
    "compile": _both(_compile, programs=COMPILERS),
    "onnxruntime": by_onnxruntime.PREPARATIONS,
    "openvino": by_openvino.PREPARATIONS,
    "cuda_graphs": _both(_cuda_graph, devices=("cuda",)),
}
"""Engine -> precision -> its `Preparation`."""
