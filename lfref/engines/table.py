"""The table of engines, and how one is made ready: `prepared(engine, precision, job)`."""

from collections.abc import Mapping

import torch
from torch import Tensor

from lfref.engines import by_onnxruntime, by_openvino, channels_last, compiled, cuda_graphs, eager
from lfref.engines.engine import INT8, Inputs, Job, Run, Way
from lfref.errors import InputError, chosen

ENGINES: dict[str, Mapping[str, Way]] = {
    "eager": eager.WAYS,
    "channels_last": channels_last.WAYS,
    "compile": compiled.WAYS,
    "onnxruntime": by_onnxruntime.WAYS,
    "openvino": by_openvino.WAYS,
    "cuda_graphs": cuda_graphs.WAYS,
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
