"""PyTorch operation by operation, the channels of a pixel beside each other in memory."""

import copy

import torch
from torch import nn

from lfref.engines.engine import BF16, FP32, Job, Run, Way, in_bf16


def arranged(network: nn.Module) -> nn.Module:
    """A copy whose convolutions read and write channels last.

    Args:
        network: Left as it is.
    """
    made: nn.Module = copy.deepcopy(network).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return made


def fp32(job: Job) -> Run:
    """The network, rearranged."""
    return arranged(job.network)


def bf16(job: Job) -> Run:
    """Likewise, with convolutions in bfloat16."""
    return in_bf16(arranged(job.network))


WAYS = {FP32: Way(fp32), BF16: Way(bf16)}
