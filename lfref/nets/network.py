"""The interface of refocusing networks, and the data-dependent start of a last convolution.

With the paper's final ReLU, about half of all random seeds start with an output channel that is negative on every
pixel and never learns. `prime` scales the last convolution on the first batch: every channel starts at its label's
mean with a small spread.
"""

import abc
from collections.abc import Callable
from typing import Any, ClassVar, cast

import torch
from torch import Tensor, nn

Total = Callable[[Tensor], Tensor]
"""Sum of a tensor over all processes of a distributed run."""

FLAT = 1e-3
"""Standard deviation below which an output counts as constant."""
SPREAD = 0.1
"""Standard deviation of each output channel at the start, in radiance; with it, no channel was dead on 48 seeds."""


def one_process(value: Tensor) -> Tensor:
    """The total over a single process: the value itself."""
    return value


class Network(nn.Module, abc.ABC):
    """Views [..., V, U, C, H, W] and slopes [N] -> stack [..., N, C, H, W]."""

    name: ClassVar[str]
    """Name of this kind of network in checkpoints."""
    config: dict[str, Any]
    """The arguments that build this network again, in plain containers."""
    n_planes: int | None
    """Number of planes that it makes; None: one for each slope."""
    grid: tuple[int, int] | None
    """View rows and columns (V, U) that it reads; None: any grid."""

    @property
    def like(self) -> Tensor:
        """A tensor of the network's type, on its device."""
        return next(self.parameters())

    @abc.abstractmethod
    def forward(self, views: Tensor, slopes: Tensor | None = None) -> Tensor:
        """Refocus.

        Args:
            views: Radiance in [0, 1], in the type of the weights, [..., V, U, C, H, W].
            slopes: Slopes in pixels per view step, float64, [N]; a network with fixed planes needs none.

        Returns:
            Stack, [..., N, C, H, W].

        Raises:
            InputError: Views or slopes that do not fit the network.
        """

    def prime(self, views: Tensor, slopes: Tensor | None, labels: Tensor, total: Total = one_process) -> None:
        """Start the weights on a first batch, in place; by default nothing changes.

        Args:
            views: This process's part of the batch, [B, V, U, C, H, W].
            slopes: Slopes of the planes, [N].
            labels: Labels of these views, [B, N, C, H, W].
            total: Function that adds up a tensor over all processes, which hold the other parts.
        """


@torch.no_grad()
def prime(head: nn.Conv2d, features: Tensor, labels: Tensor, total: Total = one_process) -> None:
    """Rescale a convolution with a bias, in place, so that features [B, F, H, W] give the means of labels [B, K, H, W].

    `total` adds up a tensor over all processes, which hold the other parts of the batch.
    """
    raw = head(features).double()
    count = total(torch.tensor(float(raw[:, 0].numel()), dtype=torch.float64, device=raw.device))
    mean = total(raw.sum((0, 2, 3))) / count
    deviation = (total((raw - mean[:, None, None]).square().sum((0, 2, 3))) / (count - 1)).sqrt()
    # A constant channel cannot be scaled: it gets the right mean, and training does the rest.
    gain = torch.where(deviation > FLAT, SPREAD / deviation.clamp(min=FLAT), 1.0)
    target = total(labels.double().sum((0, 2, 3))) / count
    bias = cast(Tensor, head.bias)
    head.weight.mul_(gain[:, None, None, None])
    bias.copy_(target - (mean - bias) * gain)
