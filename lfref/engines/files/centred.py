"""Networks whose normalisations read what has a mean of nearly 0 already, so that it does not matter how one is taken.

Of frames that are flat, runtimes that add up in float32 make a mean that is off by more than what varies: pictures of a
small RefNet were off by .008 in OpenVINO, of the one of 12.5 million weights by .15 in ONNX Runtime.
"""

import copy

from torch import Tensor, nn


class Centred(nn.Module):
    """A normalisation, after the mean was taken off.

    Args:
        norm: What is made the same by.
    """

    def __init__(self, norm: nn.InstanceNorm2d | nn.GroupNorm) -> None:
        super().__init__()
        self.norm = norm
        self.n_groups = norm.num_groups if isinstance(norm, nn.GroupNorm) else norm.num_features

    def forward(self, features: Tensor) -> Tensor:
        """Normalise."""
        grouped = features.unflatten(1, (self.n_groups, -1))
        made: Tensor = self.norm((grouped - grouped.mean((2, 3, 4), keepdim=True)).flatten(1, 2))
        return made


def centred(module: nn.Module) -> nn.Module:
    """A copy that normalises so.

    Args:
        module: Left as it is.
    """
    return _replaced(copy.deepcopy(module))


def _replaced(module: nn.Module) -> nn.Module:
    if isinstance(module, nn.InstanceNorm2d | nn.GroupNorm):
        return Centred(module)
    for name, child in module.named_children():
        setattr(module, name, _replaced(child))
    return module
