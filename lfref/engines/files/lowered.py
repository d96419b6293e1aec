"""Networks whose convolutions are of half precision, and all between them in float32: what is kept in a file halves."""

import copy

import torch
from torch import Tensor, nn

from lfref.engines.engine import BF16, FP16

DTYPES = {FP16: torch.float16, BF16: torch.bfloat16}
"""Precision -> type of the convolutions."""


class Half(nn.Module):
    """A convolution of half precision between tensors of another one.

    Args:
        convolution: What it does.
        dtype: That it does it in.
    """

    def __init__(self, convolution: nn.Conv2d, dtype: torch.dtype) -> None:
        super().__init__()
        self.convolution = convolution.to(dtype)
        self.dtype = dtype

    @property
    def weight(self) -> Tensor:
        """What it multiplies by, in the type of what it is called with."""
        return self.convolution.weight.float()

    def forward(self, features: Tensor) -> Tensor:
        """Apply it."""
        made: Tensor = self.convolution(features.to(self.dtype))
        return made.to(features.dtype)


def lowered(module: nn.Module, precision: str) -> nn.Module:
    """A copy whose convolutions are of half precision.

    Args:
        module: Left as it is.
        precision: A key of `DTYPES`.
    """
    return _replaced(copy.deepcopy(module), DTYPES[precision])


def _replaced(module: nn.Module, dtype: torch.dtype) -> nn.Module:
    if isinstance(module, nn.Conv2d):
        return Half(module, dtype)
    for name, child in module.named_children():
        setattr(module, name, _replaced(child, dtype))
    return module
