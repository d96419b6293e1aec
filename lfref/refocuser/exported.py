"""Exported files as refocusers: whatever runtime computes them, they are called like the networks they were made of."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from lfref.engines.engine import Run
from lfref.engines.files import formats
from lfref.engines.files.manifest import GUIDES, VIEWS, Manifest
from lfref.errors import CheckpointError, InputError, first_line
from lfref.geometry import planes_from
from lfref.lightfield import check_views
from lfref.nets.network import Network
from lfref.nets.refiner import Correction
from lfref.refocuser import refined
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.refined import RefinedRefocuser
from lfref.refocuser.refocuser import Refocuser


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
    """Guides, pictures and doubts -> better pictures by a runtime, on the CPU.

    Args:
        run: Takes them, float32.
        config: Of the refiner that it was made of.
    """

    def __init__(self, run: Run, config: Mapping[str, Any]) -> None:
        super().__init__()
        self.run = run
        self.config = dict(config)
        self.n_offers = int(config["n_offers"])

    @property
    def like(self) -> Tensor:
        """As in `Network`."""
        return torch.empty(0)

    def forward(self, guides: Tensor, pictures: Tensor, doubts: Tensor) -> Tensor:
        """As in `Refiner`."""
        return _called(self.run, *(each.float().contiguous() for each in (guides, pictures, doubts))).to(pictures)


def load(path: Path) -> Refocuser:
    """An exported file as a refocuser.

    Args:
        path: What `lfref export` wrote.

    Raises:
        CheckpointError: Another file, or it says of itself what cannot be.
        InputError: A package is missing that runs it.
    """
    run, manifest = formats.opened(path)
    try:
        return (_refined if GUIDES in manifest.inputs else _network)(run, manifest)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise CheckpointError(f"{path} must say what it holds", got=error, remedy="export it anew") from error


def _network(run: Run, manifest: Manifest) -> NetworkRefocuser:
    network, planes = ExportedNetwork(run, manifest), planes_from(manifest.planes or {})
    return NetworkRefocuser(network, planes, manifest.name, manifest.is_linear)


def _refined(run: Run, manifest: Manifest) -> RefinedRefocuser:
    base, names = refined.described(manifest.config)
    return RefinedRefocuser(ExportedRefiner(run, manifest.config[refined.KIND]), base, names, manifest.name)


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
