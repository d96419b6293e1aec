"""What every refocusing network is: called with views and slopes, named, and able to start itself on a first batch."""

import abc
from collections.abc import Callable
from typing import Any, ClassVar

from torch import Tensor, nn

Total = Callable[[Tensor], Tensor]
"""Adds up a tensor over all processes of a distributed run."""


def alone(value: Tensor) -> Tensor:
    """The total over one process: the value itself."""
    return value


class Network(nn.Module, abc.ABC):
    """Views [..., V, U, C, H, W] and slopes [N] -> stack [..., N, C, H, W]."""

    name: ClassVar[str]
    """What checkpoints call this kind of network."""
    config: dict[str, Any]
    """The arguments that build this network again, in plain containers."""
    n_planes: int | None
    """Number of planes that it makes; None: as many as it is given slopes."""
    grid: tuple[int, int] | None
    """View rows and columns (V, U) that it reads; None: any."""

    @property
    def like(self) -> Tensor:
        """A tensor of the type and on the device that it works in."""
        return next(self.parameters())

    @abc.abstractmethod
    def forward(self, views: Tensor, slopes: Tensor | None = None) -> Tensor:
        """Refocus.

        Args:
            views: Radiance in [0, 1], in the type of the weights, [..., V, U, C, H, W].
            slopes: In pixels per view step, float64, [N]; a network that makes fixed planes does without.

        Returns:
            Stack, [..., N, C, H, W].

        Raises:
            InputError: Views or slopes that do not fit the network.
        """

    def prime(self, views: Tensor, slopes: Tensor | None, labels: Tensor, total: Total = alone) -> None:
        """Start the weights on a first batch, in place; this one leaves them as they are.

        Args:
            views: First batch of views, or this process's part of it, [B, V, U, C, H, W].
            slopes: Of its planes, [N].
            labels: Its labels, [B, N, C, H, W].
            total: Adds up over the processes that hold the other parts.
        """
