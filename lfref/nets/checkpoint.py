"""Checkpoints of trained refocusers: plain containers and tensors, nothing that could run code.

A file holds `lfref` (format, network arguments, focal planes) and `state_dict`; Lightning's own entries may stand
beside them. Reading is `weights_only`, networks are built from a table of names, and addresses are refused.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from lfref.errors import CheckpointError, InputError
from lfref.geometry import FocalPlanes
from lfref.io import atomic
from lfref.nets.refnet import RefNet

FORMAT = 1
PREFIX = "net."  # under which a training module holds its network

NETWORKS: dict[str, type[RefNet]] = {"refnet": RefNet}


class Refocuser(nn.Module):
    """A trained network with the focal planes it was trained for.

    Args:
        network: Views [..., V, U, C, H, W] -> stack [..., N, C, H, W].
        planes: What the N planes are.
    """

    def __init__(self, network: RefNet, planes: FocalPlanes) -> None:
        super().__init__()
        if len(planes) != network.config["n_planes"]:
            raise InputError(f"a network of {network.config['n_planes']} planes needs as many alphas", got=len(planes))
        self.network = network
        self.planes = planes
        self.eval()

    @property
    def alphas(self) -> tuple[float, ...]:
        """Relative focal distance of each plane, [N]."""
        return self.planes.alphas

    @property
    def slopes(self) -> Tensor:
        """Slope of each plane in pixels per view step, float64, [N]."""
        return self.planes.slopes

    @torch.no_grad()
    def forward(self, views: Tensor) -> Tensor:
        """Refocus, without gradients.

        Args:
            views: Radiance in [0, 1], on the network's device, [..., V, U, C, H, W].

        Returns:
            Stack [..., N, C, H, W], type of the views.

        Raises:
            InputError: Views that do not fit the network.
        """
        weight = self.network.head.weight
        return self.network(views.to(weight.dtype)).to(views.dtype)


def payload(network: RefNet, planes: FocalPlanes) -> dict[str, Any]:
    """The entry `lfref` of a checkpoint: what builds the network again."""
    return {"format": FORMAT, "network": {"name": "refnet", **network.config}, "planes": planes.as_dict()}


def save(path: str | Path, network: RefNet, planes: FocalPlanes) -> None:
    """Write a checkpoint of a network alone.

    Args:
        path: File to write; replaced as a whole or not at all.
        network: The network.
        planes: What its planes are.

    Raises:
        FileError: The file cannot be written.
    """
    state = {PREFIX + name: value for name, value in network.state_dict().items()}
    with atomic.replacing(Path(path)) as temporary:
        torch.save({"lfref": payload(network, planes), "state_dict": state}, temporary)


def load(path: str | Path | None = None, device: str | torch.device = "cpu") -> Refocuser:
    """Read a trained refocuser.

    Args:
        path: A checkpoint that `lfref train` wrote. None stands for a model that ships with lfref; this version
            ships none.
        device: Where the network goes.

    Returns:
        A callable from views [..., V, U, C, H, W] to a stack [..., N, C, H, W] with `alphas` and `slopes`.

    Raises:
        CheckpointError: Missing, damaged, not ours, or of another shape than it says.
    """
    if path is None:
        raise CheckpointError("no model ships with this version", remedy="train one (lfref train) and give its path")
    contents = read(path)
    refocuser = _build(path, contents["lfref"])
    _load_state(path, refocuser.network, contents["state_dict"])
    return refocuser.to(device)


def read(path: str | Path) -> dict[str, Any]:
    """The plain contents of a checkpoint file.

    Raises:
        CheckpointError: Missing, damaged or not ours.
    """
    if "://" in str(path):
        raise CheckpointError("a checkpoint must be a local file", got=path, remedy="download it first")
    if not Path(path).is_file():
        raise CheckpointError(f"no checkpoint at {path}", remedy="give the .ckpt file of a run (RUN/checkpoints)")
    try:
        contents = torch.load(path, map_location="cpu", weights_only=True)
    # Over a foreign file the unpickler raises whatever it stumbles on; torch's advice to load it unsafely is not ours.
    except Exception as error:
        raise CheckpointError(f"{path} is damaged or no checkpoint", remedy="train or copy it anew") from error
    if not isinstance(contents, dict) or not all(
        isinstance(contents.get(key), dict) for key in ("lfref", "state_dict")
    ):
        raise CheckpointError(f"{path} was not written by lfref", remedy="give the .ckpt file of an lfref run")
    return contents


def _build(path: str | Path, entry: Mapping[str, Any]) -> Refocuser:
    if entry.get("format") != FORMAT:
        raise CheckpointError(f"{path} must have format {FORMAT}", got=entry.get("format"), remedy="update lfref")
    try:
        arguments = dict(entry["network"])
        name = arguments.pop("name", None)
        if name not in NETWORKS:
            raise CheckpointError(f"{path} must hold one of {', '.join(NETWORKS)}", got=name, remedy="update lfref")
        return Refocuser(NETWORKS[name](**arguments), FocalPlanes(**entry["planes"]))
    except CheckpointError:
        raise
    except (TypeError, KeyError, ValueError) as error:
        raise CheckpointError(f"{path} describes no network that can be built", got=error) from error


def _load_state(path: str | Path, network: nn.Module, state: Mapping[str, Tensor]) -> None:
    found = {str(key).removeprefix(PREFIX): value for key, value in state.items() if str(key).startswith(PREFIX)}
    for name, wanted in network.state_dict().items():
        got = tuple(found[name].shape) if isinstance(found.get(name), Tensor) else "nothing"
        if got != tuple(wanted.shape):
            raise CheckpointError(f"{path}: {name} must be {tuple(wanted.shape)}", got=got, remedy="train it anew")
    network.load_state_dict({name: found[name] for name in network.state_dict()})
