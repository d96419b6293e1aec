"""What is written into a file, and what the file says of itself: one JSON text under one key of its metadata.

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
"""Files of format 1 have no digest of the whole file (`lfref.io.tensor_files`)."""
LONGEST = 2**20
"""Characters of the text, at most."""
VIEWS, FEATURES = "views", "features"
"""First input of networks that read views, and of refiners."""
FORMER_FEATURES = "guides"
"""First input of refiners in files of earlier versions."""

Axes = tuple[int | str, ...]


@dataclass(frozen=True, eq=False)
class Graph:
    """A network whose pictures may have any size, as it goes into a file."""

    module: nn.Module
    """In evaluation mode, its weights in float32, on the CPU; it returns one tensor."""
    inputs: Mapping[str, Axes]
    """Axes of the inputs by name, in the order of the arguments."""
    output: Axes
    """Axes of the output."""
    example: Inputs
    """Inputs with which the network is traced; no free axis may have a length that is a special case, such as 1."""
    patches: Sequence[Inputs] = ()
    """Inputs by which int8 is calibrated."""

    @property
    def workload(self) -> EngineWorkload:
        """The module with its inputs, as engines take it."""
        return EngineWorkload(self.module, self.example, self.patches)

    @property
    def free(self) -> tuple[dict[int, str], ...]:
        """For each input, the letters of its free axes by their place."""
        return tuple(
            {place: axis for place, axis in enumerate(axes) if isinstance(axis, str)} for axes in self.inputs.values()
        )


@dataclass(frozen=True)
class Manifest:
    """What a file says of itself."""

    name: str
    """As tables call it."""
    inputs: Mapping[str, Axes]
    """By name, in their order; `views` [B, V, U, C, H, W], or `features`, `pictures` and `error_scale`; float32."""
    output: Axes
    """Of the stack, float32."""
    precision: str
    """Precision of its arithmetic or of its weights."""
    sha256: str
    """Digest of the network's weights in float32."""
    version: str
    """Of the lfref that wrote it."""
    planes: Mapping[str, Any] | None = None
    """`slopes` in pixels per view step, and `convention` and `alphas` if they were written so; None: any."""
    is_linear: bool | None = None
    """Whether it reads linear light, or samples as files hold them; None: both."""
    config: Mapping[str, Any] = field(default_factory=dict)
    """What builds the same network again."""

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
