"""Whatever was trained, shipped or exported, read from a file as a refocuser."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from lfref.engines.engine import Run
from lfref.engines.files import file_formats
from lfref.engines.files.manifest import VIEWS, Manifest
from lfref.errors import CheckpointError, InputError, first_line
from lfref.geometry import planes_from
from lfref.io.run import Run as RunFolder
from lfref.io.run import run_name
from lfref.lightfield import check_views
from lfref.nets import checkpoint
from lfref.nets.network import Network
from lfref.nets.refiner import Correction
from lfref.refocuser import refined
from lfref.refocuser.features import renamed
from lfref.refocuser.networks import NetworkRefocuser, learned
from lfref.refocuser.refined import RefinedRefocuser
from lfref.refocuser.refocuser import Refocuser

# PART exported
# Exported files as refocusers: whatever runtime computes them, they are called like the networks they were made of.


class ExportedNetwork(Network):
    """Views -> stack by a runtime, on the CPU.

    Args:
        run: Takes views [B, V, U, C, H, W], float32.
        manifest: What its file says of it.
    """

    name = "exported"

    def __init__(self, run: Run, manifest: Manifest) -> None:
        super().__init__()
        _, n_rows, n_columns, channels, *_ = manifest.inputs[VIEWS]
        self.run = run
        self.config = {"channels": channels}
        self.n_planes = int(manifest.output[1])
        self.grid = (int(n_rows), int(n_columns))

    @property
    def like(self) -> Tensor:
        """As in `Network`."""
        return torch.empty(0)

    def forward(self, views: Tensor, slopes: Tensor | None = None) -> Tensor:
        """As in `Network`.

        Raises:
            InputError: Views of another grid or of other channels.
        """
        check_views(views)
        *leading, n_rows, n_columns, n_channels, _, _ = views.shape
        grid, wanted = self.grid, self.config["channels"]
        assert grid is not None
        if (n_rows, n_columns) != grid or wanted not in (n_channels, "C"):
            raise InputError(
                f"this file reads views [..., {grid[0]}, {grid[1]}, {wanted}, H, W]",
                got=f"shape {list(views.shape)}",
                remedy=f"cut the light field to that grid (reader.views={grid[0]})",
            )
        made = _called(self.run, views.reshape(-1, *views.shape[-5:]).float().contiguous())
        return made.reshape(*leading, *made.shape[1:])


class ExportedRefiner(Correction):
    """Features, pictures and error scale -> better pictures by a runtime, on the CPU.

    Args:
        run: Takes them, float32.
        config: Of the refiner that it was made of.
    """

    def __init__(self, run: Run, config: Mapping[str, Any]) -> None:
        super().__init__()
        self.run = run
        self.config = dict(config)
        self.n_candidates = int(config["n_candidates"])

    @property
    def like(self) -> Tensor:
        """As in `Network`."""
        return torch.empty(0)

    def forward(self, features: Tensor, pictures: Tensor, error_scale: Tensor) -> Tensor:
        """As in `Refiner`."""
        return _called(self.run, *(each.float().contiguous() for each in (features, pictures, error_scale))).to(
            pictures
        )


def load_exported(path: Path) -> Refocuser:
    """An exported file as a refocuser.

    Args:
        path: What `lfref export` wrote.

    Raises:
        CheckpointError: Another file, or it says of itself what cannot be.
        InputError: A package is missing that runs it.
    """
    run, manifest = file_formats.opened(path)
    try:
        return (_network if manifest.reads_views else _refined)(run, manifest)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise CheckpointError(f"{path} must say what it holds", got=error, remedy="export it anew") from error


def _network(run: Run, manifest: Manifest) -> NetworkRefocuser:
    network, planes = ExportedNetwork(run, manifest), planes_from(manifest.planes or {})
    return NetworkRefocuser(network, planes, manifest.name, manifest.is_linear)


def _refined(run: Run, manifest: Manifest) -> RefinedRefocuser:
    base, names = refined.described(manifest.config)
    return RefinedRefocuser(ExportedRefiner(run, renamed(manifest.config[refined.KIND])), base, names, manifest.name)


def _called(run: Run, *inputs: Tensor) -> Tensor:
    """What a runtime makes of them; over views that it cannot take it raises whatever it likes."""
    try:
        # What a file computes in was settled when it was written.
        with torch.autocast("cpu", enabled=False):
            return run(*inputs)
    except Exception as error:
        shapes = ", ".join("x".join(map(str, each.shape)) for each in inputs)
        raise InputError(
            f"this file must be able to refocus {shapes}", got=first_line(error), remedy="give larger views"
        ) from error


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
    path = RunFolder.of(path).best if Path(path).is_dir() else Path(path)
    if file_formats.of(path) is not None:
        return load_exported(path).to(torch.device(device))
    contents = checkpoint.read(path)
    if refined.KIND in contents["lfref"]:
        return refined.restored(path, contents, run_name(path), device)
    network, planes = checkpoint.restored(path, contents)
    return NetworkRefocuser(network.to(device), planes, run_name(path), contents["lfref"].get("is_linear"))
