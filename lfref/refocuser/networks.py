"""Trained networks as refocusers, and the one that ships with lfref."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from lfref.geometry import FocalPlanes
from lfref.nets import checkpoint
from lfref.nets.network import Network
from lfref.refocus import batches
from lfref.refocuser.refocuser import Refocuser, light_for_network

SHIPPED = {"refnet": Path(__file__).parents[1] / "weights" / "refnet.safetensors"}
"""Weights of the models that ship, by name; their metadata state how they were trained."""


class NetworkRefocuser(Refocuser):
    """A trained network with the planes that it was trained for, without gradients."""

    is_network = True

    def __init__(
        self, network: Network, planes: FocalPlanes, name: str | None = None, is_linear: bool | None = None
    ) -> None:
        checkpoint.check_number(network, planes)
        self.module = self.network = network.eval()
        self.name = network.name if name is None else name
        self.planes = None if network.n_planes is None else planes
        self.grid = network.grid
        self.is_linear = is_linear

    @torch.no_grad()
    def stack(self, views: Tensor, weight: Tensor | None, slopes: Tensor, positions: Tensor | None = None) -> Tensor:
        """The network's stack; integer views are scaled to [0, 1]."""
        like = next(self.network.parameters())
        radiance = light_for_network(self.name, views, weight, positions, like.device)
        return self.network(radiance.to(like.dtype), slopes).to(batches.stack_dtype(views))


def restored_network(
    path: Path,
    contents: Mapping[str, Any],
    name: str,
    device: str | torch.device = "cpu",
    net: type[Network] | None = None,
) -> NetworkRefocuser:
    """The refocuser of a checkpoint, from what `checkpoint.read` returned; `net`: class of a network not of lfref."""
    network, planes = checkpoint.restored(path, contents, net)
    return NetworkRefocuser(network.to(device), planes, name, contents["lfref"].get("is_linear"))


def refnet(name: str = "refnet", device: str | torch.device = "cpu") -> NetworkRefocuser:
    """The RefNet that ships with lfref: 7x7 views, the paper's 16 planes."""
    return restored_network(SHIPPED["refnet"], checkpoint.read(SHIPPED["refnet"]), name, device)
