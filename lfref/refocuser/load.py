"""`lfref.load`: runs, checkpoints and exported files as refocusers.

A runtime such as ONNX Runtime computes an exported file, which is called like the network that it was made of.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from lfref.encoding import parsed
from lfref.engines.engine import NetworkFunction
from lfref.engines.files import file_formats
from lfref.engines.files.manifest import SAMPLE_TYPES, SLOPES, VIEWS, Manifest, to_samples
from lfref.errors import CheckpointError, InputError, chosen, first_line
from lfref.geometry import planes_from
from lfref.io.run import Run, run_name
from lfref.lightfield import check_views
from lfref.nets import checkpoint
from lfref.nets.network import Network
from lfref.nets.refiner import Corrector
from lfref.refocus import batches
from lfref.refocus.separable_wiener import separable_wiener
from lfref.refocus.shift.shift_and_sum import disparity_range, shift_and_sum_through_cells
from lfref.refocuser import filling, networks
from lfref.refocuser.features import renamed
from lfref.refocuser.networks import NetworkRefocuser, RefinedRefocuser, learned, refnet
from lfref.refocuser.refocuser import Refocuser, check_for_network


def load(path: str | Path | None = None, device: str | torch.device = "cpu") -> Refocuser:
    """Read a trained refocuser.

    Args:
        path: A run of `lfref train`, whose best checkpoint is taken, or a checkpoint; named after the run. A file that
            `lfref export` wrote, `NAME.onnx`, `.pt2`, `.xml` or `.safetensors`. A model that ships with lfref:
            `refnet` (7x7 views, the paper's 16 planes), or `learned`, which None means too (any planes, any even grid).
        device: Where the network goes; exported files run on the CPU, wherever views are.

    Returns:
        A callable from a light field or views [..., V, U, C, H, W] to a stack [..., N, C, H, W], with `planes`.

    Raises:
        CheckpointError: Missing, damaged, not ours, or of another shape than it says.
        InputError: An exported file whose runtime is not installed.

    Example:
        >>> from lfref.nets import checkpoint
        >>> checkpoint.save("net.ckpt", lfref.RefNet(n_planes=2, grid=(3, 3), widths=(8,)), lfref.even_planes(2))
        >>> refocuser = lfref.load("net.ckpt")
        >>> refocuser(torch.rand(3, 3, 3, 24, 32)).shape, refocuser.planes.labels
        (torch.Size([2, 3, 24, 32]), ('slope -1', 'slope 1'))
    """
    if path in (None, "learned"):
        return learned(device=device)
    if path == "refnet":
        return refnet(device=device)
    path = Run.of(path).best if Path(path).is_dir() else Path(path)
    if file_formats.format_of(path) is not None:
        refocuser = load_exported(path)
        refocuser.device = torch.device("cpu")
        return refocuser
    contents = checkpoint.read(path)
    if networks.REFINER in contents["lfref"]:
        return networks.restored_refiner(path, contents, run_name(path), device)
    return networks.restored_network(path, contents, run_name(path), device)


def load_exported(path: Path) -> Refocuser:
    """A file that `lfref export` wrote as a refocuser.

    Raises:
        CheckpointError: The file is another one, or its manifest is wrong.
        InputError: Its runtime is not installed.
    """
    run, manifest = file_formats.read(path)
    try:
        if SLOPES in manifest.inputs:
            return ExportedOperator(run, manifest)
        if manifest.reads_views:
            network, planes = ExportedNetwork(run, manifest), planes_from(manifest.planes or {})
            return NetworkRefocuser(network, planes, manifest.name, manifest.is_linear)
        base, names = networks.described_refiner(manifest.config)
        refiner = ExportedRefiner(run, renamed(manifest.config[networks.REFINER]))
        return RefinedRefocuser(refiner, base, names, manifest.name)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise CheckpointError(f"{path} must say what it holds", got=error, remedy="export it anew") from error


FIND_DISPARITIES = (shift_and_sum_through_cells.__name__, separable_wiener.__name__)
"""Operators of files that estimate the disparities of the scene, as far as views move little."""


class ExportedOperator(Refocuser):
    """Views and slopes -> stack by a runtime, on the CPU; it takes linear light, whatever encoding the file reads."""

    def __init__(self, run: NetworkFunction, manifest: Manifest) -> None:
        n_rows, n_columns, *_ = manifest.inputs[VIEWS]
        self.run, self.name = run, manifest.name
        self.grid: tuple[int, int] = (int(n_rows), int(n_columns))
        chosen("samples", manifest.samples, SAMPLE_TYPES)
        self.samples, self.encoding = manifest.samples, parsed(manifest.encoding)
        self.finds_disparities = manifest.config["operator"] in FIND_DISPARITIES
        self.n_channels = manifest.inputs[VIEWS][2]

    def stack(self, views: Tensor, weight: Tensor | None, slopes: Tensor, positions: Tensor | None = None) -> Tensor:
        """The file's stack.

        Raises:
            InputError: Views that are not finite or of another grid, slopes that shift them too far, cameras that do
                not stand on an even grid.
        """
        light = batches.radiance(views)
        check_for_network(self.name, light, positions, torch.device("cpu"))
        _check_grid(views, self.grid, self.n_channels)
        planes = batches.checked_slopes(slopes, *batches.grid_and_size(views), None).float()
        if weight is not None:
            # The file has no input for weights.
            light = filling.filled(light, weight.to(light))
        fields = batches.flattened(light).float()
        if self.finds_disparities and any(disparity_range(field).sure is not None for field in fields):
            raise InputError(
                f"{self.name} as a file needs views that move by less than about 3 pixels per view step, less if small",
                got="views that move farther",
                remedy="use the method instead of its file",
            )
        samples = to_samples(fields, self.samples, self.encoding)
        stacks = torch.stack([_computed(self.run, field, planes) for field in samples])
        return batches.restored(self.encoding.decode(stacks), views)


class ExportedNetwork(Network):
    """Views [..., V, U, C, H, W] -> stack by a runtime, on the CPU."""

    name = "exported"

    def __init__(self, run: NetworkFunction, manifest: Manifest) -> None:
        super().__init__()
        _, n_rows, n_columns, n_channels, *_ = manifest.inputs[VIEWS]
        self.run = run
        self.config = {"channels": n_channels}
        self.n_planes = int(manifest.output[1])
        self.grid: tuple[int, int] = (int(n_rows), int(n_columns))

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
        _check_grid(views, self.grid, self.config["channels"])
        stack = _computed(self.run, views.reshape(-1, *views.shape[-5:]).float())
        return stack.reshape(*views.shape[:-5], *stack.shape[1:])


class ExportedRefiner(Corrector):
    """Features, pictures and error scale -> better pictures by a runtime, on the CPU."""

    def __init__(self, run: NetworkFunction, config: Mapping[str, Any]) -> None:
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
        return _computed(self.run, features.float(), pictures.float(), error_scale.float()).to(pictures)


def _check_grid(views: Tensor, grid: tuple[int, int], n_channels: int | str = "C") -> None:
    if tuple(views.shape[-5:-3]) != grid or n_channels not in (views.shape[-3], "C"):
        raise InputError(
            f"this file reads views [..., {grid[0]}, {grid[1]}, {n_channels}, H, W]",
            got=f"shape {list(views.shape)}",
            remedy=f"read them with reader.views=[{grid[0]},{grid[1]}]",
        )


@torch.no_grad()
def _computed(run: NetworkFunction, *inputs: Tensor) -> Tensor:
    """Output of a runtime; errors of any kind become one line."""
    try:
        # The precision of a file was settled when it was written.
        with torch.autocast("cpu", enabled=False):
            return run(*(tensor.contiguous() for tensor in inputs))
    except Exception as error:
        shapes = ", ".join("x".join(map(str, tensor.shape)) for tensor in inputs)
        raise InputError(
            f"this file must be able to refocus {shapes}", got=first_line(error), remedy="give larger views"
        ) from error
