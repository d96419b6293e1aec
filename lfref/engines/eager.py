"""PyTorch as it is, operation by operation: what the other engines are compared with."""

from lfref.engines.engine import BF16, FP32, Job, Run, Way, in_bf16


def fp32(job: Job) -> Run:
    """The network itself."""
    return job.network


def bf16(job: Job) -> Run:
    """The network, with convolutions in bfloat16."""
    return in_bf16(job.network)


WAYS = {FP32: Way(fp32), BF16: Way(bf16)}
