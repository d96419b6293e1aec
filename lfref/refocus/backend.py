"""Which code computes: loops compiled by Numba on the CPU, by Triton on a GPU, else PyTorch, which differentiates."""

import importlib.util

import torch
from torch import Tensor

COMPILERS = {"cpu": "numba"} | ({"cuda": "triton"} if importlib.util.find_spec("triton") else {})
"""The compiler that serves each type of device."""


def compiler_for(*tensors: Tensor) -> str | None:
    """`numba` or `triton` where compiled loops can serve, None where PyTorch's operations have to.

    Args:
        *tensors: What is to be computed with, all on one device.
    """
    return COMPILERS.get(tensors[0].device.type) if all(map(is_plain, tensors)) else None


def is_plain(tensor: Tensor) -> bool:
    """Whether code outside PyTorch may read these numbers: not while traced, nor where derivatives are asked for.

    Args:
        tensor: Any.
    """
    is_asked_for = tensor.requires_grad and torch.is_grad_enabled()
    if torch.compiler.is_compiling() or type(tensor) is not Tensor or is_asked_for:
        return False
    try:
        tensor.data_ptr()
    except RuntimeError:  # what `torch.func` transforms wrap has no memory of its own
        return False
    return torch.autograd.forward_ad.unpack_dual(tensor).tangent is None
