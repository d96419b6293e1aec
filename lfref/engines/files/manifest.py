"""The graph that a file holds, and the manifest that describes it: one JSON text under one key of the metadata.

Axes are numbers where they are fixed and letters where any length will do: `B` light fields, `V U` view rows and
columns, `N` planes, `K` channels of features, `C H W` channel, pixel row and column.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import nn

from lfref.engines.engine import EngineWorkload, Inputs
from lfref.errors import CheckpointError
from lfref.io import tensor_files

KEY = "lfref"
"""Key of the text in the metadata of a file."""
FORMAT = 2
"""Format of the files; files of format 1 have no digest of the whole file (`lfref.io.tensor_files`)."""
LONGEST = 2**20
"""Greatest length of the text, in characters."""
VIEWS, FEATURES = "views", "features"
"""Name of the first input of networks that read views, and of refiners."""
FORMER_FEATURES = "guides"
"""Name of the first input of refiners in files of earlier versions."""

Axes = tuple[int | str, ...]


@dataclass(frozen=True, eq=False)
class Graph:
    """A network whose pictures may have any size, as it goes into a file."""

    module: nn.Module
    """The network in evaluation mode, on the CPU, with weights in float32; it returns one tensor."""
    inputs: Mapping[str, Axes]
    """Axes of the inputs by name, in the order of the arguments."""
    output: Axes
    """Axes of the output."""
    example: Inputs
    """Inputs with which the network is traced; no free axis may have a length that is a special case, such as 1."""
    patches: Sequence[Inputs] = ()
    """Inputs on which int8 is calibrated."""

    @property
    def workload(self) -> EngineWorkload:
        """The module with its inputs, as engines take it."""
        return EngineWorkload(self.module, self.example, self.patches)

    @property
    def free(self) -> tuple[dict[int, str], ...]:
        """Letter of each free axis by its place, for each input."""
        return tuple(
            {place: axis for place, axis in enumerate(axes) if isinstance(axis, str)} for axes in self.inputs.values()
        )


@dataclass(frozen=True)
class Manifest:
    """Description of the network in a file."""

    name: str
    """Name of the network in tables."""
    inputs: Mapping[str, Axes]
    """Axes of the inputs (float32) by name: `views` [B, V, U, C, H, W], or `features`, `pictures` and `error_scale`."""
    output: Axes
    """Axes of the stack (float32)."""
    precision: str
    """Precision of its arithmetic or of its weights."""
    sha256: str
    """Digest of the network's weights in float32."""
    version: str
    """Version of the lfref that wrote the file."""
    planes: Mapping[str, Any] | None = None
    """`slopes` in pixels per view step, and `convention` and `alphas` if the planes have them; None: any planes."""
    is_linear: bool | None = None
    """Whether the network reads linear light; False: samples as files hold them; None: both."""
    config: Mapping[str, Any] = field(default_factory=dict)
    """Arguments that build the same network again."""

    @property
    def reads_views(self) -> bool:
        """Whether the network makes stacks of views; if not, it corrects pictures that lfref has refocused."""
        return VIEWS in self.inputs

    def text(self) -> str:
        """The manifest as JSON."""
        return json.dumps({"format": FORMAT} | asdict(self))


def parse(path: Path, text: str | None, has_digest: bool) -> Manifest:
    """The manifest in the text under `KEY` of the file at `path`, which has a digest or comes from an earlier version.

    Raises:
        CheckpointError: The text is no manifest, or the digest is missing.
    """
    if text is None or len(text) > LONGEST:
        raise CheckpointError(f"{path} was not written by lfref export", remedy="export it anew")
    try:
        entries = json.loads(text)
        if (number := entries.pop("format")) not in (1, FORMAT):
            raise CheckpointError(f"{path} must have format {FORMAT}", remedy="update lfref, or export it anew")
        if number == FORMAT and not has_digest:
            raise CheckpointError(f"{path} is damaged or was changed", got="no SHA-256", remedy="export it anew")
        inputs = {str(name): _axes(axes) for name, axes in entries.pop("inputs").items()}
        manifest = Manifest(inputs=inputs, output=_axes(entries.pop("output")), **entries)
    except CheckpointError:
        raise
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise CheckpointError(f"{path} must say what it holds", got=error, remedy="export it anew") from error
    if next(iter(inputs), None) not in (VIEWS, FEATURES, FORMER_FEATURES) or not isinstance(manifest.config, dict):
        raise CheckpointError(f"{path} must read {VIEWS} or {FEATURES}", got=list(inputs), remedy="export it anew")
    if not has_digest:
        tensor_files.warn_without_digest(path)
    return manifest


def _axes(entry: Any) -> Axes:
    axes = tuple(entry)
    if not 3 <= len(axes) <= 6 or not all(type(axis) in (int, str) for axis in axes):
        raise ValueError(f"axes {axes}")
    return axes


def digest(module: nn.Module) -> str:
    """SHA-256 of the names, shapes and values of all weights, in float32."""
    sha256 = hashlib.sha256()
    for name, value in sorted(module.state_dict().items()):
        sha256.update(f"{name} {list(value.shape)}\n".encode())
        sha256.update(value.detach().cpu().to(torch.float32).contiguous().numpy().tobytes())
    return sha256.hexdigest()
