"""Checkpoints of trained networks: plain containers and tensors, nothing that could run code.

A file holds `lfref` (format, network arguments, focal planes) and `state_dict`; Lightning's own entries may stand
beside them. A safetensors file holds the same without Lightning's entries. Reading is `weights_only`,
and networks are built from a table of names, or of the class that the caller gives, no larger than the file.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Tensor, nn

from lfref.errors import CheckpointError, InputError, first_line
from lfref.geometry import FocalPlanes, planes_from
from lfref.io import tensor_files
from lfref.nets.network import Network
from lfref.nets.refnet import RefNet

NETWORKS: dict[str, type[Network]] = {RefNet.name: RefNet}
FORMAT = 2
Module = TypeVar("Module", bound=nn.Module)
PREFIX = "net."
"""Prefix of the weights in a checkpoint: training modules hold their network as `net`."""


def payload(network: Network, planes: FocalPlanes, is_linear: bool = True) -> dict[str, Any]:
    """The entry `lfref` of a checkpoint, which describes the network; `is_linear`: whether it reads linear light."""
    kind = type(network)
    # The full name of another class is only read by people: no class is imported because a file names it.
    name = network.name if NETWORKS.get(network.name) is kind else f"{kind.__module__}.{kind.__qualname__}"
    arguments = {"name": name, **network.config}
    return {"format": FORMAT, "network": arguments, "planes": planes.as_dict(), "is_linear": is_linear}


def check_number(network: Network, planes: FocalPlanes) -> None:
    """Raise an InputError if a network does not make as many planes as there are in `planes`."""
    if network.n_planes not in (None, len(planes)):
        expected, remedy = f"the network must make {len(planes)} planes", f"set net.n_planes={len(planes)}"
        raise InputError(expected, got=network.n_planes, remedy=remedy)


def save(path: str | Path, network: Network, planes: FocalPlanes) -> None:
    """Write a checkpoint of a network alone; FileError if the disk refuses."""
    state = {PREFIX + name: value for name, value in network.state_dict().items()}
    tensor_files.write_checkpoint(Path(path), {"lfref": payload(network, planes), "state_dict": state})


def write_weights(path: str | Path, contents: Mapping[str, Any], notes: Mapping[str, Any]) -> None:
    """Write the network of a checkpoint, as `read` returned it, as safetensors, with notes for readers of the file."""
    state = {name: value for name, value in contents["state_dict"].items() if name.startswith(PREFIX)}
    tensor_files.write_weights(path, state, {"lfref": contents["lfref"], "notes": notes})


def read(path: str | Path) -> dict[str, Any]:
    """The entries `lfref` and `state_dict` of a file, and Lightning's entries; CheckpointError for other files."""
    if not Path(path).is_file():
        raise CheckpointError(f"no checkpoint at {path}", remedy="give the .ckpt file of a run (RUN/checkpoints)")
    if Path(path).suffix == tensor_files.SUFFIX:
        state, metadata = tensor_files.read_weights(path)
        contents: Any = metadata | {"state_dict": state}
    else:
        contents = tensor_files.read_checkpoint(Path(path))
    parts = [contents.get(key) for key in ("lfref", "state_dict")] if isinstance(contents, dict) else [None]
    if not all(isinstance(part, dict) for part in parts):
        raise CheckpointError(f"{path} was not written by lfref", remedy="give the .ckpt file of an lfref run")
    return contents


def restored(
    path: str | Path, contents: Mapping[str, Any], net: type[Network] | None = None
) -> tuple[Network, FocalPlanes]:
    """The network of a checkpoint (of class `net`, if it is not one of ours) and its planes; errors name `path`."""
    entry = contents["lfref"]
    if entry.get("format") != FORMAT:
        raise CheckpointError(f"{path} must have format {FORMAT}", got=entry.get("format"), remedy="update lfref")
    try:
        arguments = dict(entry["network"])
        name = arguments.pop("name", None)
        kind = NETWORKS.get(name) if net is None else net
        if kind is None:
            expected, remedy = f"{path} must hold one of our networks", "give its class: load(path, net=CLASS)"
            raise CheckpointError(expected, got=name, remedy=remedy)
        planes = planes_from(entry["planes"])
        network: Network = built(path, kind, arguments, contents["state_dict"])
        check_number(network, planes)
    except CheckpointError:
        raise
    # RuntimeError: more numbers than PyTorch can count.
    except (TypeError, KeyError, ValueError, AttributeError, OverflowError, RuntimeError) as error:
        raise CheckpointError(f"{path} describes no network that can be built", got=first_line(error)) from error
    return network, planes


def built(path: str | Path, kind: type[Module], arguments: Mapping[str, Any], state: Mapping[str, Any]) -> Module:
    """The network of a class with these arguments, which may be hostile, and its weights; errors name `path`."""
    weights = network_weights(path, state)
    # Networks of other packages may need memory to be built; the user trusts these packages.
    if kind.__module__.startswith("lfref."):
        # Without a limit, a list or number in a small file builds more layers than fit into memory.
        lengths = [len(value) for value in arguments.values() if isinstance(value, list)]
        if max([*lengths, arguments.get("n_blocks") or 0]) > max(2, len(weights)):
            raise CheckpointError(f"{path} must hold the weights of all blocks", got=f"{len(weights)} tensors")
        with torch.device("meta"):
            compare(path, kind(**arguments), weights)
    network = kind(**arguments)
    fill(path, network, weights)
    return network


def start(network: nn.Module, path: str | Path) -> None:
    """Give a network the weights of a file to begin training with; CheckpointError if it holds none of this shape."""
    fill(path, network, network_weights(path, read(path)["state_dict"]))


def fill(path: str | Path, network: nn.Module, weights: Mapping[str, Tensor]) -> None:
    """Give a network its weights; CheckpointError if they do not fit."""
    compare(path, network, weights)
    network.load_state_dict({name: weights[name] for name in network.state_dict()})


def network_weights(path: str | Path, state: Mapping[str, Any]) -> dict[str, Tensor]:
    """The network's part of a `state_dict`, by its own names: plain finite tensors, no larger than the file."""
    weights = {str(key).removeprefix(PREFIX): value for key, value in state.items() if str(key).startswith(PREFIX)}
    views = {}
    for name, value in weights.items():
        # Each test assumes that the tests before it hold.
        if (
            not isinstance(value, Tensor)
            or (value.layout, value.device.type, value.is_quantized) != (torch.strided, "cpu", False)
            or value.is_complex()
            or value.nbytes > value.untyped_storage().nbytes()
            or not bool(value.isfinite().all())
        ):
            raise CheckpointError(f"{path}: {name} must be a plain tensor of finite numbers", remedy="train it anew")
        views[value.data_ptr(), value.numel()] = value.nbytes
    if sum(views.values()) > Path(path).stat().st_size:
        raise CheckpointError(f"{path} must hold all weights", got="one part used several times")
    return weights


def compare(path: str | Path, network: nn.Module, weights: Mapping[str, Tensor]) -> None:
    """Refuse weights that do not fit a network."""
    for name, own in network.state_dict().items():
        got: Any = tuple(weights[name].shape) if name in weights else "nothing"
        if got != tuple(own.shape) or weights[name].is_floating_point() != own.is_floating_point():
            raise CheckpointError(f"{path}: {name} must be {tuple(own.shape)}, {own.dtype}", got=got)
