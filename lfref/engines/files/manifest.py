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
from torch import Tensor, nn

from lfref.encoding import Encoding
from lfref.engines.engine import EngineWorkload, Inputs
from lfref.errors import CheckpointError
from lfref.io import tensor_files

KEY = "lfref"
"""Key of the text in the metadata of a file."""
FORMAT, FORMATS = 3, (1, 2, 3)
"""Format of the files, and those that are read. Files of format 1 have no digest of the whole file
(`lfref.io.tensor_files`); operators in files of format 2 have their slopes baked in."""
LONGEST = 2**20
"""Greatest length of the text, in characters."""
VIEWS, FEATURES, SLOPES, STACK = "views", "features", "slopes", "stack"
"""Names: first input of networks that read views, and of refiners; second input of operators; output."""
FORMER_FEATURES = "guides"
"""Name of the first input of refiners in files of earlier versions."""

SAMPLE_TYPES = {
    "float32": (torch.float32, 1),
    "uint8": (torch.uint8, 255),
    "uint16": (torch.uint16, 65535),
}
"""Types of views that a file may read, and the sample of radiance 1."""

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
    """Axes of the inputs by name: `views` [V, U, C, H, W] and `slopes` [N] (float32) of an operator, `views`
    [B, V, U, C, H, W] of a network, or `features`, `pictures` and `error_scale` of a refiner (float32)."""
    output: Axes
    """Axes of the stack (float32)."""
    precision: str
    """Precision of its arithmetic or of its weights."""
    sha256: str
    """Digest of the network's weights in float32 and of `config`: what the file was made of."""
    version: str
    """Version of the lfref that wrote the file."""
    planes: Mapping[str, Any] | None = None
    """`slopes` in pixels per view step, and `convention` and `alphas` if the planes have them; None: any planes."""
    is_linear: bool | None = None
    """Whether the network reads linear light; False: samples as files hold them; None: both."""
    config: Mapping[str, Any] = field(default_factory=dict)
    """Arguments that build the same network again; of an operator its name, options and weights of views."""
    samples: str = "float32"
    """Type of the views, a key of `SAMPLE_TYPES`."""
    encoding: str = "linear"
    """Tone curve of views and stack: `linear`, `srgb`, `gamma:EXPONENT`, or `none` for samples as files hold them."""
    license: str | None = None
    """Licence of the file; None: not stated."""
    notes: Mapping[str, str] = field(default_factory=dict)
    """Meaning of each input and of the output, for people."""

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
        if (number := entries.pop("format")) not in FORMATS:
            raise CheckpointError(f"{path} must have format {FORMAT}", remedy="update lfref, or export it anew")
        if number > 1 and not has_digest:
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
    if not 1 <= len(axes) <= 6 or not all(type(axis) in (int, str) for axis in axes):
        raise ValueError(f"axes {axes}")
    return axes


def digest(module: nn.Module, config: Mapping[str, Any]) -> str:
    """SHA-256 of a configuration and of the names, shapes and values of all weights, in float32."""
    sha256 = hashlib.sha256(json.dumps(config, sort_keys=True).encode())
    for name, value in sorted(module.state_dict().items()):
        sha256.update(f"{name} {list(value.shape)}\n".encode())
        sha256.update(value.detach().cpu().to(torch.float32).contiguous().numpy().tobytes())
    return sha256.hexdigest()


def to_samples(light: Tensor, samples: str, encoding: Encoding) -> Tensor:
    """Linear light as a file reads it: a type of `SAMPLE_TYPES`, a tone curve."""
    dtype, full_scale = SAMPLE_TYPES[samples]
    values = encoding.encode(light)
    return values.to(dtype) if full_scale == 1 else (values.clamp(0, 1) * full_scale).round().to(dtype)


def to_light(views: Tensor, samples: str, encoding: Encoding, dtype: torch.dtype = torch.float32) -> Tensor:
    """Undo `to_samples`."""
    full_scale = SAMPLE_TYPES[samples][1]
    return encoding.decode(views.to(dtype) if full_scale == 1 else views.to(dtype) / full_scale)


def notes(inputs: Mapping[str, Axes], samples: str, encoding: str) -> dict[str, str]:
    """Meaning of inputs and output, for people who have only the file."""
    if VIEWS not in inputs:
        return {STACK: "corrected pictures; the inputs are features that only lfref computes"}
    curve = {
        "linear": "proportional to light",
        "none": "encoded as in the files of its training",
    }.get(encoding, f"encoded as {encoding}")
    full_scale = SAMPLE_TYPES[samples][1]
    texts = {
        VIEWS: f"{samples}, {full_scale} is white, {curve}. v: view row, grows downwards; u: view column, grows to the "
        "right; c: red, green, blue; y: pixel row, grows downwards; x: pixel column, grows to the right",
        STACK: f"float32, 1 is white, {curve}; one picture for each slope, registered with the centre of the views",
    }
    if SLOPES in inputs:
        texts[SLOPES] = (
            "float32, pixels per view step. A point whose picture moves by d pixels to the right when u grows by 1, "
            "and downwards when v grows by 1, is in focus at slope d"
        )
    return texts
