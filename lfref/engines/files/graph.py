"""What is written into a file: a module, what it is given, and which axes may have any length.

Letters: those of `manifest`.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import nn

from lfref.engines.engine import Inputs, Job
from lfref.engines.files.manifest import Axes


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
