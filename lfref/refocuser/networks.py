"""Trained networks as refocusers, for the planes and the grid of their training; the model that ships with lfref."""

from pathlib import Path

import torch
from torch import Tensor

from lfref.geometry import FocalPlanes
from lfref.nets import checkpoint
from lfref.nets.network import Network
from lfref.refocus import batches
from lfref.refocuser import filling, refined
from lfref.refocuser.refined import RefinedRefocuser
from lfref.refocuser.refocuser import Aperture, Refocuser, check_for_network

SHIPPED = Path(__file__).parents[1] / "weights" / "learned.safetensors"
"""Weights of the model that ships; their metadata state how it was trained."""


class NetworkRefocuser(Refocuser):
    """A trained network with the planes that it was trained for, without gradients.

    Args:
        network: Views and slopes -> stack.
        planes: Planes of its labels.
        name: As tables and legends call it; None takes the network's own.
        is_linear: Whether it was trained on linear light or on encoded samples; None: not known.

    Raises:
        InputError: The network makes another number of planes.
    """

    def __init__(
        self, network: Network, planes: FocalPlanes, name: str | None = None, is_linear: bool | None = None
    ) -> None:
        checkpoint.check_number(network, planes)
        self.network = network.eval()
        self.name = network.name if name is None else name
        self.planes = None if network.n_planes is None else planes
        self.grid = network.grid
        self.is_linear = is_linear

    def to(self, device: torch.device) -> "NetworkRefocuser":
        """As in `Refocuser`."""
        self.network.to(device)
        return self

    @torch.no_grad()
    def stack(self, views: Tensor, weight: Tensor | None, slopes: Tensor, positions: Tensor | None = None) -> Tensor:
        """The network's stack; integer views are scaled to [0, 1].

        Raises:
            InputError: Views that are not finite, lie on another device, or do not fit the network; cameras that do
                not stand on an even grid.
        """
        radiance = batches.radiance(views)
        check_for_network(self.name, radiance, positions, self.network.like.device)
        if weight is not None:
            # The network has no input for weights: untrusted samples are replaced by what the other views show.
            radiance = filling.filled(radiance, weight.to(radiance))
        return self.network(radiance.to(self.network.like.dtype), slopes).to(batches.stack_dtype(views))


def learned(
    name: str = "learned", aperture: Aperture | None = None, device: str | torch.device = "cpu"
) -> RefinedRefocuser:
    """The model that ships with lfref: a classical method whose pictures a network corrects.

    Args:
        name: As tables and legends call it.
        aperture: Weights of the views of any grid; None weighs all alike.
        device: Where the network goes.

    Raises:
        CheckpointError: The installation is damaged.

    Example:
        >>> lfref.load()(torch.rand(5, 5, 3, 48, 64), [-0.5, 0.5]).shape
        torch.Size([2, 3, 48, 64])
    """
    return refined.restored(SHIPPED, checkpoint.read(SHIPPED), name, device).through(aperture)
