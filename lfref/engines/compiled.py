"""PyTorch's own compiler (Inductor): what stands between convolutions becomes loops written for this network.

Weights count as constants, which it rearranges once for the convolutions of the machine.
"""

import torch
from torch import Tensor

from lfref.engines import channels_last
from lfref.engines.engine import BF16, FP32, Job, Run, Way, in_bf16

COMPILERS = ("g++", "clang++", "c++")


def _compiled(run: Run) -> Run:
    def alone(*inputs: Tensor) -> Tensor:
        return run(*inputs)

    # PyTorch counts compilations by code, and gives up in silence after a few of one.
    alone.__code__ = alone.__code__.replace()
    return torch.compile(alone, dynamic=False, options={"freezing": True})


def fp32(job: Job) -> Run:
    """The network, compiled when it is first called."""
    return _compiled(channels_last.arranged(job.network))


def bf16(job: Job) -> Run:
    """Likewise, with convolutions in bfloat16."""
    return _compiled(in_bf16(channels_last.arranged(job.network)))


WAYS = {FP32: Way(fp32, programs=COMPILERS), BF16: Way(bf16, programs=COMPILERS)}
