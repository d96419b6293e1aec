"""CUDA graphs: the GPU's commands of one pass are recorded once and replayed, so that the CPU need not issue them.

Source: PyTorch, "CUDA semantics", section "CUDA Graphs".
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from lfref.engines import channels_last
from lfref.engines.engine import BF16, FP32, Inputs, Job, Run, Way, in_bf16

WARMUP = 3
"""Passes before the recording, in which libraries choose their algorithms."""


def fp32(job: Job) -> Run:
    """The network, recorded."""
    return _recorded(channels_last.arranged(job.network), job)


def bf16(job: Job) -> Run:
    """Likewise, with convolutions in bfloat16."""
    return _recorded(in_bf16(channels_last.arranged(job.network)), job)


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


WAYS = {precision: Way(prepare, devices=("cuda",)) for precision, prepare in ((FP32, fp32), (BF16, bf16))}
