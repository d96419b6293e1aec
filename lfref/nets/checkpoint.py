"""Checkpoints of trained networks: plain containers and tensors, nothing that could run code.

A file holds `lfref` (format, network arguments, focal planes) and `state_dict`; Lightning's own entries may stand
beside them, or none of it, in a file of safetensors. Reading is `weights_only`, networks are built from a table of
names, and addresses are refused.
"""

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from lfref.errors import CheckpointError, InputError
from lfref.geometry import FocalPlanes, planes_from
from lfref.io import tensor_files
from lfref.nets.kinds import KINDS
from lfref.nets.network import Network

FORMAT = 2
FORMATS = (1, 2)  # that can be read: 1 kept alphas in place of slopes
PREFIX = "net."  # under which a training module holds its network


def payload(network: Network, planes: FocalPlanes, is_linear: bool = True) -> dict[str, Any]:
    """The entry `lfref` of a checkpoint: what builds the network again.

    Args:
        network: The network.
        planes: What its planes are.
        is_linear: Whether it reads linear light, or samples as files hold them.
    """
    told = {"network": {"name": network.name, **network.config}, "planes": planes.as_dict(), "is_linear": is_linear}
    return {"format": FORMAT, **told}


def kind(name: str) -> type[Network]:
    """The class of networks of that name, one of `KINDS`."""
    module, _, attribute = KINDS[name].rpartition(".")
    made: type[Network] = getattr(importlib.import_module(module), attribute)
    return made


def check_number(network: Network, planes: FocalPlanes) -> None:
    """Refuse planes that are more or fewer than a network makes.

    Raises:
        InputError: They are.
    """
    if network.n_planes not in (None, len(planes)):
        raise InputError(
            f"the network must make as many planes as there are ({len(planes)})",
            got=network.n_planes,
            remedy=f"set net.n_planes={len(planes)}",
        )


def save(path: str | Path, network: Network, planes: FocalPlanes) -> None:
    """Write a checkpoint of a network alone.

    Args:
        path: File to write; replaced as a whole or not at all.
        network: The network.
        planes: What its planes are.

    Raises:
        FileError: The file cannot be written.
    """
    state = {PREFIX + name: value for name, value in network.state_dict().items()}
    tensor_files.write_checkpoint(Path(path), {"lfref": payload(network, planes), "state_dict": state})


def restore(path: str | Path) -> tuple[Network, FocalPlanes]:
    """The network of a checkpoint, on the CPU, and the planes that it was trained for.

    Args:
        path: A checkpoint that `lfref train` or `save` wrote.

    Raises:
        CheckpointError: Missing, damaged, not ours, or of another shape than it says.
    """
    return restored(path, read(path))


def restored(path: str | Path, contents: Mapping[str, Any]) -> tuple[Network, FocalPlanes]:
    """As `restore`, of a checkpoint that was read.

    Args:
        path: Of the checkpoint, for errors.
        contents: Of `read`.

    Raises:
        CheckpointError: It describes no network, or one of another shape.
    """
    network, planes = _build(path, contents["lfref"])
    load_state(path, network, contents["state_dict"])
    return network, planes


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
        contents = _weights(path) if Path(path).suffix == tensor_files.SUFFIX else _pickled(path)
    except CheckpointError:
        raise
    # Over a foreign file the unpickler raises whatever it stumbles on; torch's advice to load it unsafely is not ours.
    except Exception as error:
        raise CheckpointError(f"{path} is damaged or no checkpoint", remedy="train or copy it anew") from error
    if not isinstance(contents, dict) or not all(
        isinstance(contents.get(key), dict) for key in ("lfref", "state_dict")
    ):
        raise CheckpointError(f"{path} was not written by lfref", remedy="give the .ckpt file of an lfref run")
    return contents


def _pickled(path: str | Path) -> Any:
    return torch.load(path, map_location="cpu", weights_only=True)


def _weights(path: str | Path) -> dict[str, Any]:
    """A file of weights alone, as `write_weights` wrote it."""
    state, told = tensor_files.read_weights(path)
    return told | {"state_dict": state}


def write_weights(path: str | Path, contents: Mapping[str, Any], notes: Mapping[str, Any]) -> None:
    """Write the network of a checkpoint alone, as safetensors, which `read` reads too.

    Args:
        path: File to write, `NAME.safetensors`; replaced as a whole or not at all.
        contents: Of `read`.
        notes: How it was made, plain containers.

    Raises:
        FileError: The file cannot be written.
    """
    state = {name: each for name, each in contents["state_dict"].items() if name.startswith(PREFIX)}
    tensor_files.write_weights(path, state, {"lfref": contents["lfref"], "notes": notes})


def _build(path: str | Path, entry: Mapping[str, Any]) -> tuple[Network, FocalPlanes]:
    if entry.get("format") not in FORMATS:
        raise CheckpointError(f"{path} must have format {FORMAT}", got=entry.get("format"), remedy="update lfref")
    try:
        arguments = dict(entry["network"])
        name = arguments.pop("name", None)
        if name not in KINDS:
            raise CheckpointError(f"{path} must hold one of {', '.join(KINDS)}", got=name, remedy="update lfref")
        network, planes = kind(name)(**arguments), planes_from(entry["planes"])
        check_number(network, planes)
    except CheckpointError:
        raise
    except (TypeError, KeyError, ValueError) as error:
        raise CheckpointError(f"{path} describes no network that can be built", got=error) from error
    return network, planes


def load_state(path: str | Path, network: nn.Module, state: Mapping[str, Tensor]) -> None:
    """Give a network the weights of a checkpoint.

    Args:
        path: Of the checkpoint, for errors.
        network: The network.
        state: `state_dict` of the checkpoint.

    Raises:
        CheckpointError: It holds weights of other shapes, or lacks some.
    """
    found = {str(key).removeprefix(PREFIX): value for key, value in state.items() if str(key).startswith(PREFIX)}
    for name, wanted in network.state_dict().items():
        got = tuple(found[name].shape) if isinstance(found.get(name), Tensor) else "nothing"
        if got != tuple(wanted.shape):
            raise CheckpointError(f"{path}: {name} must be {tuple(wanted.shape)}", got=got, remedy="train it anew")
    network.load_state_dict({name: found[name] for name in network.state_dict()})
