"""CUDA graphs: the GPU's commands of one pass are recorded once and replayed, so that the CPU need not issue them.

Source: PyTorch, "CUDA semantics", section "CUDA Graphs".
"""

import copy
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from lfref.engines import by_onnxruntime, by_openvino
from lfref.engines.engine import BF16, FP32, INT8, Inputs, Job, Run, Way, in_bf16
from lfref.errors import InputError, chosen

# PART eager
# PyTorch as it is, operation by operation: what the other engines are compared with.


def fp32(job: Job) -> Run:
    """The network itself."""
    return job.network


def bf16(job: Job) -> Run:
    """The network, with convolutions in bfloat16."""
    return in_bf16(job.network)


WAYS = {FP32: Way(fp32), BF16: Way(bf16)}


# PART channels_last
# PyTorch operation by operation, the channels of a pixel beside each other in memory.


def arranged(network: nn.Module) -> nn.Module:
    """A copy whose convolutions read and write channels last.

    Args:
        network: Left as it is.
    """
    made: nn.Module = copy.deepcopy(network).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return made


def fp32_of_channels_last(job: Job) -> Run:
    """The network, rearranged."""
    return arranged(job.network)


def bf16_of_channels_last(job: Job) -> Run:
    """Likewise, with convolutions in bfloat16."""
    return in_bf16(arranged(job.network))


WAYS_OF_CHANNELS_LAST = {FP32: Way(fp32_of_channels_last), BF16: Way(bf16_of_channels_last)}


# PART compiled
# PyTorch's own compiler (Inductor): what stands between convolutions becomes loops written for this network.
#
# Weights count as constants, which it rearranges once for the convolutions of the machine.

COMPILERS = ("g++", "clang++", "c++")


def _compiled(run: Run) -> Run:
    def alone(*inputs: Tensor) -> Tensor:
        return run(*inputs)

    # PyTorch counts compilations by code, and gives up in silence after a few of one.
    alone.__code__ = alone.__code__.replace()
    return torch.compile(alone, dynamic=False, options={"freezing": True})


def fp32_of_compiled(job: Job) -> Run:
    """The network, compiled when it is first called."""
    return _compiled(arranged(job.network))


def bf16_of_compiled(job: Job) -> Run:
    """Likewise, with convolutions in bfloat16."""
    return _compiled(in_bf16(arranged(job.network)))


WAYS_OF_COMPILED = {FP32: Way(fp32_of_compiled, programs=COMPILERS), BF16: Way(bf16_of_compiled, programs=COMPILERS)}


WARMUP = 3
"""Passes before the recording, in which libraries choose their algorithms."""


def fp32_of_cuda_graphs(job: Job) -> Run:
    """The network, recorded."""
    return _recorded(arranged(job.network), job)


def bf16_of_cuda_graphs(job: Job) -> Run:
    """Likewise, with convolutions in bfloat16."""
    return _recorded(in_bf16(arranged(job.network)), job)


def _recorded(run: Run, job: Job) -> Run:
    # A graph reads and writes where it did when it was recorded.
    inputs = tuple(each.clone() for each in job.example)
    stream = torch.cuda.Stream(job.device)
    stream.wait_stream(torch.cuda.current_stream(job.device))
    with torch.cuda.stream(stream):
        for _ in range(WARMUP):
            run(*inputs)
    torch.cuda.current_stream(job.device).wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        stack = run(*inputs)

    return Recorded(run, graph, inputs, stack)


@dataclass(frozen=True, eq=False)
class Recorded:
    """A pass that is replayed."""

    run: Run
    """What was recorded: the graph reads the weights where they were then, so they must stay."""
    graph: torch.cuda.CUDAGraph
    inputs: Inputs
    """Where it reads."""
    stack: Tensor
    """Where it writes."""

    def __call__(self, *given: Tensor) -> Tensor:
        """Replay it."""
        for place, each in zip(self.inputs, given, strict=True):
            place.copy_(each)
        self.graph.replay()
        return self.stack.clone()


WAYS_OF_CUDA_GRAPHS = {
    precision: Way(prepare, devices=("cuda",))
    for precision, prepare in ((FP32, fp32_of_cuda_graphs), (BF16, bf16_of_cuda_graphs))
}


# PART table
# The table of engines, and how one is made ready: `prepared(engine, precision, job)`.

ENGINES: dict[str, Mapping[str, Way]] = {
    "eager": WAYS,
    "channels_last": WAYS_OF_CHANNELS_LAST,
    "compile": WAYS_OF_COMPILED,
    "onnxruntime": by_onnxruntime.WAYS,
    "openvino": by_openvino.WAYS,
    "cuda_graphs": WAYS_OF_CUDA_GRAPHS,
}
"""By name, each precision that it can do."""


def way(engine: str, precision: str) -> Way:
    """One precision of one engine.

    Args:
        engine: A key of `ENGINES`.
        precision: `fp32`, `bf16` or `int8`.

    Raises:
        InputError: There is no such engine, or it can't do that.
    """
    return chosen(f"precision of engine {engine}", precision, chosen("engine", engine, ENGINES))


def prepared(engine: str, precision: str, job: Job) -> Run:
    """A network made ready to run.

    Args:
        engine: A key of `ENGINES`.
        precision: `fp32`, `bf16` or `int8`.
        job: The network and what it will be given; for `int8` with patches.

    Returns:
        What is called like the network and returns the like, without gradients.

    Raises:
        InputError: There is no such engine, something that it needs is missing, or the job doesn't fit.

    Example:
        >>> job = Job(torch.nn.Conv2d(3, 8, 3).eval(), (torch.rand(1, 3, 16, 16),))
        >>> prepared("channels_last", "bf16", job)(torch.rand(1, 3, 16, 16)).shape
        torch.Size([1, 8, 14, 14])
    """
    found = way(engine, precision)
    if (lacking := found.lacking(job.device)) is not None:
        raise lacking
    if job.network.training:
        raise InputError("the network must be in evaluation mode", got="training mode", remedy="call network.eval()")
    if precision == INT8 and not job.patches:
        raise InputError("int8 is scaled by what a network reads", got="no patches", remedy="give Job(patches=...)")
    with torch.no_grad():
        return _guarded(found.prepare(job), job.example)


def _guarded(run: Run, example: Inputs) -> Run:
    expected = [_told(each) for each in example]

    @torch.no_grad()
    def guarded(*inputs: Tensor) -> Tensor:
        if (got := [_told(each) for each in inputs]) != expected:
            remedy = "prepare it for inputs like these"
            raise InputError(f"this engine was prepared for {', '.join(expected)}", got=", ".join(got), remedy=remedy)
        return run(*inputs)

    return guarded


def _told(tensor: Tensor) -> str:
    return f"{'x'.join(map(str, tensor.shape))} {str(tensor.dtype).removeprefix('torch.')}"
