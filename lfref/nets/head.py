"""Data-dependent start of a last convolution, so that no output channel is born dead.

With the paper's final ReLU, about half of all random seeds start with an output channel that is negative on every
pixel and never learns. Scaled on the first batch, every channel starts at its label's mean with a small spread.
"""

from typing import cast

import torch
from torch import Tensor, nn

from lfref.nets.network import Total, alone

FLAT = 1e-3  # standard deviation below which an output is taken for constant
SPREAD = 0.1  # standard deviation of each output channel at the start, in radiance


@torch.no_grad()
def prime(head: nn.Conv2d, features: Tensor, labels: Tensor, spread: float = SPREAD, total: Total = alone) -> None:
    """Rescale a convolution on one batch, in place.

    Args:
        head: The convolution, with a bias.
        features: What it reads, [B, F, H, W].
        labels: What its channels should become, [B, K, H, W].
        spread: Standard deviation that each output channel gets, in radiance.
        total: Adds up over the processes that hold other parts of the batch.
    """
    raw = head(features).double()
    count = total(torch.tensor(float(raw[:, 0].numel()), dtype=torch.float64, device=raw.device))
    mean = total(raw.sum((0, 2, 3))) / count
    deviation = (total((raw - mean[:, None, None]).square().sum((0, 2, 3))) / (count - 1)).sqrt()
    # A channel that does not vary at all has nothing to scale: it gets the right mean and learns the rest.
    gain = torch.where(deviation > FLAT, spread / deviation.clamp(min=FLAT), 1.0)
    target = total(labels.double().sum((0, 2, 3))) / count
    bias = cast(Tensor, head.bias)
    head.weight.mul_(gain[:, None, None, None])
    bias.copy_(target - (mean - bias) * gain)
