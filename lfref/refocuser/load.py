"""Whatever was trained, shipped or exported, read from a file as a refocuser."""

from pathlib import Path

import torch

from lfref.engines.files import formats
from lfref.io.run import Run, run_name
from lfref.nets import checkpoint
from lfref.refocuser import exported, refined
from lfref.refocuser.networks import NetworkRefocuser, learned
from lfref.refocuser.refocuser import Refocuser


def load(path: str | Path | None = None, device: str | torch.device = "cpu") -> Refocuser:
    """Read a trained refocuser.

    Args:
        path: A run of `lfref train`, whose best checkpoint is taken, or a checkpoint; named after the run. A file that
            `lfref export` wrote, `NAME.onnx`, `.pt2`, `.xml` or `.safetensors`. None is the model that ships with
            lfref, which makes any planes of any even grid.
        device: Where the network goes.

    Returns:
        A callable from a light field or views [..., V, U, C, H, W] to a stack [..., N, C, H, W], with `planes`.

    Raises:
        CheckpointError: Missing, damaged, not ours, or of another shape than it says.
        InputError: An exported file on another device than the CPU, or a package is missing that runs it.

    Example:
        >>> from lfref.nets import checkpoint
        >>> checkpoint.save("net.ckpt", lfref.RefNet(n_planes=2, grid=(3, 3), widths=(8,)), lfref.even_planes(2))
        >>> refocuser = lfref.load("net.ckpt")
        >>> refocuser(torch.rand(3, 3, 3, 24, 32)).shape, refocuser.planes.labels
        (torch.Size([2, 3, 24, 32]), ('slope -1', 'slope 1'))
    """
    if path is None:
        return learned(device=device)
    path = Run.of(path).best if Path(path).is_dir() else Path(path)
    if formats.of(path) is not None:
        return exported.load(path).to(torch.device(device))
    contents = checkpoint.read(path)
    if refined.KIND in contents["lfref"]:
        return refined.restored(path, contents, run_name(path), device)
    network, planes = checkpoint.restored(path, contents)
    return NetworkRefocuser(network.to(device), planes, run_name(path), contents["lfref"].get("is_linear"))
