"""Data-dependent initialisation of RefNet's last convolution, so that no output channel is born dead.

With the paper's final ReLU, about half of all random seeds start with an output channel that is negative on every
pixel and never learns. Scaled on the first batch, every channel starts at its label's mean with a small spread.
"""

from typing import cast

import torch
from torch import Tensor

from lfref.nets.refnet import RefNet

FLAT = 1e-3  # standard deviation below which an output is taken for constant
SPREAD = 0.1  # standard deviation of each output channel at the start, in radiance


@torch.no_grad()
def initialize_head(network: RefNet, views: Tensor, labels: Tensor, spread: float = SPREAD) -> None:
    """Rescale the last convolution on one batch, in place.

    Args:
        network: The network to start.
        views: First batch of views, [B, V, U, C, H, W].
        labels: Its labels, [B, N, C, H, W].
        spread: Standard deviation that each output channel gets, in radiance.
    """
    head = network.head
    raw = head(network.features(views))
    deviation, mean = torch.std_mean(raw, dim=(0, 2, 3))
    # A channel that does not vary at all has nothing to scale: it gets the right mean and learns the rest.
    gain = torch.where(deviation > FLAT, spread / deviation.clamp(min=FLAT), 1.0)
    target = labels.flatten(1, 2).mean(dim=(0, 2, 3)).to(mean)
    bias = cast(Tensor, head.bias)
    head.weight.mul_(gain[:, None, None, None])
    bias.copy_(target - (mean - bias) * gain)
