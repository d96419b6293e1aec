"""Weights alone, as safetensors: no graph, but what lfref builds the same network of, on any device."""

from pathlib import Path

import torch
from torch import Tensor, nn

from lfref.engines.engine import BF16, FP16, FP32, Run
from lfref.errors import InputError, chosen
from lfref.io.safetensors import SUFFIX
from lfref.nets import checkpoint
from lfref.refocuser import refined
from lfref.refocuser.load import load
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.refined import RefinedRefocuser
from lfref.refocuser.refocuser import Refocuser

__all__ = ["DTYPES", "SUFFIX", "opened", "write"]

DTYPES = {FP32: torch.float32, FP16: torch.float16, BF16: torch.bfloat16}
"""That weights are kept in, by precision; they are computed with in float32."""


def write(path: Path, refocuser: Refocuser, precision: str, version: str) -> None:
    """Write the weights of a network.

    Args:
        path: The file, `NAME.safetensors`.
        refocuser: A network or a refiner.
        precision: A key of `DTYPES`.
        version: Of lfref.

    Raises:
        InputError: It has no weights, or they can't be kept in that precision.
        FileError: The disk refuses.
    """
    dtype = chosen("precision of safetensors", precision, DTYPES)
    module: nn.Module
    if isinstance(refocuser, NetworkRefocuser) and refocuser.planes is not None:
        module, is_linear = refocuser.network, refocuser.is_linear is not False
        told = checkpoint.payload(refocuser.network, refocuser.planes, is_linear)
    elif isinstance(refocuser, RefinedRefocuser):
        module, told = refocuser.refiner, refined.payload(refocuser.refiner, refocuser.base, refocuser.names)
    else:
        raise InputError("safetensors must be of a network", got=refocuser.name, remedy="take onnx, pt2 or openvino")

    def kept(weight: Tensor) -> Tensor:
        return weight.to(dtype) if weight.is_floating_point() else weight

    state = {checkpoint.PREFIX + name: kept(weight) for name, weight in module.state_dict().items()}
    notes = {"version": version, "precision": precision}
    checkpoint.write_weights(path, {"lfref": told, "state_dict": state}, notes)


def opened(path: Path) -> Run:
    """The network of a file that `write` wrote.

    Args:
        path: The file.

    Raises:
        CheckpointError: Another file.
    """
    refocuser = load(path)
    if isinstance(refocuser, RefinedRefocuser):
        return refocuser.refiner
    assert isinstance(refocuser, NetworkRefocuser)
    return refocuser.network
