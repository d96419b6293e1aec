"""The interface of refocusing networks."""

import abc
from collections.abc import Iterable
from typing import Any, ClassVar

from torch import Tensor, nn

from lfref.nets.initialization import Total, one_process


class Network(nn.Module, abc.ABC):
    """Views [..., V, U, C, H, W] and slopes [N] -> stack [..., N, C, H, W]."""

    name: ClassVar[str]
    config: dict[str, Any]
    """The arguments that build this network again, in plain containers."""
    n_planes: int | None
    """Number of planes that it makes; None: one for each slope."""
    grid: tuple[int, int] | None
    """View rows and columns (V, U) that it reads; None: any grid."""

    @abc.abstractmethod
    def forward(self, views: Tensor, slopes: Tensor | None = None) -> Tensor:
        """Refocus views [..., V, U, C, H, W] to a stack [..., N, C, H, W]; fixed planes need no slopes."""

    def initialize(self, views: Tensor, slopes: Tensor | None, labels: Tensor, total: Total = one_process) -> None:
        """Start the weights on crops [B, V, U, C, H, W] and labels, in place; `total` adds up over all processes."""

    def ends(self) -> Iterable[nn.Parameter]:
        """Parameters of the first and last layers, which learn at `end_rate` of the rate; none by default."""
        return ()
