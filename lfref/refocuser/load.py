"""`lfref.load`: runs, checkpoints, weights and ONNX files as refocusers."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from lfref.errors import CheckpointError, InputError, first_line
from lfref.extras import needed
from lfref.geometry import planes_from
from lfref.io.run import Run, run_name
from lfref.nets import checkpoint
from lfref.nets.network import Network
from lfref.refocus import batches
from lfref.refocuser.networks import refnet, restored_network
from lfref.refocuser.refocuser import Refocuser, light_for_network

CPU = torch.device("cpu")


def load(
    path: str | Path | None = None, device: str | torch.device = "cpu", net: type[Network] | None = None
) -> Refocuser:
    """Read a trained refocuser.

    Args:
        path: A run of `lfref train`, whose best checkpoint is taken, or a checkpoint; named after the run. A file that
            `lfref export` wrote, `NAME.onnx` or `NAME.safetensors`. None or `refnet`: the RefNet that ships with lfref
            (7x7 views, the paper's 16 planes).
        device: Where the network goes; exported files run on the CPU, wherever views are.
        net: Class of the network in a checkpoint, if it is not one of ours.

    Returns:
        A callable from a light field or views [..., V, U, C, H, W] to a stack [..., N, C, H, W], with `planes`.

    Raises:
        CheckpointError: Missing, damaged, not ours, or of another shape than it says.
        InputError: An ONNX file without ONNX Runtime.

    Example:
        >>> from lfref.nets import checkpoint
        >>> checkpoint.save("net.ckpt", lfref.RefNet(n_planes=2, grid=(3, 3), widths=(8,)), lfref.even_planes(2))
        >>> refocuser = lfref.load("net.ckpt")
        >>> refocuser(torch.rand(3, 3, 3, 24, 32)).shape, refocuser.planes.labels
        (torch.Size([2, 3, 24, 32]), ('slope -1', 'slope 1'))
    """
    if path in (None, "refnet"):
        return refnet(device=device)
    path = Run.of(path).best if Path(path).is_dir() else Path(path)
    if path.suffix == ".onnx":
        return load_onnx(path)
    contents = checkpoint.read(path)
    return restored_network(path, contents, run_name(path), device, net)


DESCRIPTION = "lfref"
"""Entry of an exported file that describes it: JSON of plain values."""
VIEWS, SLOPES, STACK = "views", "slopes", "stack"


def load_onnx(path: Path) -> Refocuser:
    """An ONNX file that `lfref export` wrote, run by ONNX Runtime on the CPU."""
    with needed("an ONNX file"):
        import onnxruntime
    try:
        session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])
        description = json.loads(session.get_modelmeta().custom_metadata_map[DESCRIPTION])

        def run(*inputs: Tensor) -> Tensor:
            names = [value.name for value in session.get_inputs()]
            (stack,) = session.run([STACK], {name: each.numpy() for name, each in zip(names, inputs, strict=True)})
            return torch.from_numpy(stack)

        return Exported(run, description)
    except Exception as error:  # ONNX Runtime raises any error for a foreign file
        remedy = "give what lfref export wrote"
        raise CheckpointError(f"{path} must be a model of lfref", got=first_line(error), remedy=remedy) from error


class Exported(Refocuser):
    """A model that a runtime computes on the CPU in float32: of a network, or of an operator, which reads slopes."""

    device = CPU

    def __init__(self, run: Callable[..., Tensor], description: Mapping[str, Any]) -> None:
        *_, n_rows, n_columns, _, _, _ = description[VIEWS]
        self.run, self.name, self.grid = run, description["name"], (int(n_rows), int(n_columns))
        self.is_network, self.least = "planes" in description, int(description.get("least", 1))
        if self.is_network:
            self.planes, self.is_linear = planes_from(description["planes"]), description["is_linear"]

    @torch.no_grad()
    def stack(self, views: Tensor, weight: Tensor | None, slopes: Tensor, positions: Tensor | None = None) -> Tensor:
        """As in `Refocuser`; untrusted samples are replaced by what the other views show."""
        light = light_for_network(self.name, views, weight, positions, CPU)
        if min(views.shape[-2:]) < self.least:
            expected = f"views must have at least {self.least} rows and columns for the file of {self.name}"
            raise InputError(expected, got=list(views.shape[-2:]), remedy="use the method itself")
        fields, planes = batches.flattened(light).float().contiguous(), slopes.float()
        stacks = self.run(fields) if self.is_network else torch.stack([self.run(field, planes) for field in fields])
        return batches.restored(stacks, views)
