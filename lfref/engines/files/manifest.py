"""What an exported file says of itself: inputs, planes, how it was made, all as one JSON text under one key.

Axes are told as numbers where they are fixed and as letters where any length will do: `B` light fields, `V U` view rows
and columns, `N` planes, `K` channels of features, `C H W` channel, pixel row and column.
"""

import copy
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from lfref.engines.engine import BF16, FP16, Inputs, Job
from lfref.errors import CheckpointError

KEY = "lfref"
"""Under which the text stands in the metadata of a file."""
FORMAT = 1
LONGEST = 2**20
"""Characters of a text, at most."""
VIEWS, FEATURES = "views", "features"
"""First inputs: of networks that read views, and of refiners."""
FORMER_FEATURES = "guides"
"""What earlier versions called the features in their files."""

Axes = tuple[int | str, ...]


@dataclass(frozen=True)
class Manifest:
    """What a file holds."""

    name: str
    """As tables call it."""
    inputs: Mapping[str, Axes]
    """By name, in their order; `views` [B, V, U, C, H, W], or `features`, `pictures` and `error_scale`; float32."""
    output: Axes
    """Of the stack that it makes, float32."""
    precision: str
    """That it computes in, or that its weights are kept in."""
    sha256: str
    """Of the weights that it was made of, in float32."""
    version: str
    """Of lfref, that wrote it."""
    planes: Mapping[str, Any] | None = None
    """`slopes` in pixels per view step, and `convention` and `alphas` if they were written so; None: any."""
    is_linear: bool | None = None
    """Whether it reads linear light, or samples as files hold them; None: whatever comes."""
    config: Mapping[str, Any] = field(default_factory=dict)
    """What builds the same again."""

    @property
    def reads_views(self) -> bool:
        """Whether it refocuses by itself, or corrects what lfref has refocused."""
        return VIEWS in self.inputs

    def text(self) -> str:
        """As it stands in a file."""
        return json.dumps({"format": FORMAT} | asdict(self))


def parsed(path: Path, text: str | None) -> Manifest:
    """The manifest that a file holds.

    Args:
        path: The file, for errors.
        text: What stands under `KEY`; None: nothing.

    Raises:
        CheckpointError: It is none, or one of a later version.
    """
    if text is None or len(text) > LONGEST:
        raise CheckpointError(f"{path} was not written by lfref export", remedy="export it anew")
    try:
        told = json.loads(text)
        if told.pop("format") != FORMAT:
            raise CheckpointError(f"{path} must have format {FORMAT}", remedy="update lfref, or export it anew")
        inputs = {str(name): _axes(axes) for name, axes in told.pop("inputs").items()}
        made = Manifest(inputs=inputs, output=_axes(told.pop("output")), **told)
    except CheckpointError:
        raise
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise CheckpointError(f"{path} must say what it holds", got=error, remedy="export it anew") from error
    if next(iter(inputs), None) not in (VIEWS, FEATURES, FORMER_FEATURES) or not isinstance(made.config, dict):
        raise CheckpointError(f"{path} must read {VIEWS} or {FEATURES}", got=list(inputs), remedy="export it anew")
    return made


def _axes(told: Any) -> Axes:
    axes = tuple(told)
    if not 3 <= len(axes) <= 6 or not all(type(each) in (int, str) for each in axes):
        raise ValueError(f"axes {axes}")
    return axes


# PART graph
# What is written into a file: a module, what it is given, and which axes may have any length.
#
# Letters: those of `manifest`.


@dataclass(frozen=True, eq=False)
class Graph:
    """A function of tensors whose pictures may have any size."""

    module: nn.Module
    """In evaluation mode, its weights in float32, on the CPU; it returns one tensor."""
    inputs: Mapping[str, Axes]
    """By name, in the order in which it takes them: lengths, and a letter where any will do."""
    output: Axes
    """Likewise."""
    example: Inputs
    """It is followed with these: free axes of lengths that are no special case, 1 above all."""
    patches: Sequence[Inputs] = ()
    """By which whole numbers are scaled."""

    @property
    def job(self) -> Job:
        """As engines take it."""
        return Job(self.module, self.example, self.patches)

    @property
    def free(self) -> tuple[dict[int, str], ...]:
        """For each input, the letters of its free axes by their place."""
        return tuple(
            {place: axis for place, axis in enumerate(axes) if isinstance(axis, str)} for axes in self.inputs.values()
        )


def digest(module: nn.Module) -> str:
    """SHA-256 of the names, shapes and values of all weights, in float32.

    Args:
        module: Whose weights.
    """
    told = hashlib.sha256()
    for name, value in sorted(module.state_dict().items()):
        told.update(f"{name} {list(value.shape)}\n".encode())
        told.update(value.detach().cpu().to(torch.float32).contiguous().numpy().tobytes())
    return told.hexdigest()


# PART lowered
# Networks whose convolutions are of half precision, and all between them in float32: what is kept in a file halves.

DTYPES = {FP16: torch.float16, BF16: torch.bfloat16}
"""Precision -> type of the convolutions."""


class Half(nn.Module):
    """A convolution of half precision between tensors of another one.

    Args:
        convolution: What it does.
        dtype: That it does it in.
    """

    def __init__(self, convolution: nn.Conv2d, dtype: torch.dtype) -> None:
        super().__init__()
        self.convolution = convolution.to(dtype)
        self.dtype = dtype

    @property
    def weight(self) -> Tensor:
        """What it multiplies by, in the type of what it is called with."""
        return self.convolution.weight.float()

    def forward(self, features: Tensor) -> Tensor:
        """Apply it."""
        made: Tensor = self.convolution(features.to(self.dtype))
        return made.to(features.dtype)


def lowered(module: nn.Module, precision: str) -> nn.Module:
    """A copy whose convolutions are of half precision.

    Args:
        module: Left as it is.
        precision: A key of `DTYPES`.
    """
    return _replaced(copy.deepcopy(module), DTYPES[precision])


def _replaced(module: nn.Module, dtype: torch.dtype) -> nn.Module:
    if isinstance(module, nn.Conv2d):
        return Half(module, dtype)
    for name, child in module.named_children():
        setattr(module, name, _replaced(child, dtype))
    return module
