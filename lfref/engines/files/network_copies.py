"""Copies of networks for files: convolutions in half precision, and normalisations that centre their input first."""

import copy
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from lfref.engines.engine import BF16, FP16

HALF_TYPES = {FP16: torch.float16, BF16: torch.bfloat16}
"""Precision -> type of the convolutions."""


class Half(nn.Module):
    """A convolution in half precision between tensors of another type; its weights take half the bytes in a file."""

    def __init__(self, convolution: nn.Conv2d, dtype: torch.dtype) -> None:
        super().__init__()
        self.convolution = convolution.to(dtype)
        self.dtype = dtype

    @property
    def weight(self) -> Tensor:
        """The weights in the type of the input, since networks check this type."""
        return self.convolution.weight.float()

    def forward(self, features: Tensor) -> Tensor:
        """Apply the convolution."""
        result: Tensor = self.convolution(features.to(self.dtype))
        return result.to(features.dtype)


class Centred(nn.Module):
    """A normalisation that first centres its input, so that the precision of its own mean does not matter.

    On flat frames, the mean in runtimes that sum in float32 is off by more than the variation: pictures were off by
    0.008 for a small RefNet in OpenVINO, and by 0.15 for the RefNet of 12.5 million weights in ONNX Runtime.
    """

    def __init__(self, norm: nn.InstanceNorm2d | nn.GroupNorm) -> None:
        super().__init__()
        self.norm = norm
        self.n_groups = norm.num_groups if isinstance(norm, nn.GroupNorm) else norm.num_features

    def forward(self, features: Tensor) -> Tensor:
        """Normalise."""
        grouped = features.unflatten(1, (self.n_groups, -1))
        result: Tensor = self.norm((grouped - grouped.mean((2, 3, 4), keepdim=True)).flatten(1, 2))
        return result


def half_convolutions(module: nn.Module, precision: str) -> nn.Module:
    """A copy whose convolutions are in half precision, `fp16` or `bf16`, with float32 between them."""
    dtype = HALF_TYPES[precision]
    return _replaced(copy.deepcopy(module), nn.Conv2d, lambda convolution: Half(convolution, dtype))


def centred_norms(module: nn.Module) -> nn.Module:
    """A copy whose instance and group normalisations centre their input first."""
    return _replaced(copy.deepcopy(module), nn.InstanceNorm2d | nn.GroupNorm, Centred)


def _replaced(module: nn.Module, kinds: Any, replacement: Callable[[Any], nn.Module]) -> nn.Module:
    """The module with all parts of these classes replaced, in place."""
    if isinstance(module, kinds):
        return replacement(module)
    for name, child in module.named_children():
        setattr(module, name, _replaced(child, kinds, replacement))
    return module
