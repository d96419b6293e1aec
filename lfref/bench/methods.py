"""Every way to refocus behind one face: views and slopes in, stack out."""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.nets.checkpoint import Refocuser
from lfref.refocus import weighted


@dataclass(frozen=True)
class Method:
    """A named way to refocus."""

    name: str
    """As tables and legends call it."""
    refocus: Callable[[Tensor, Tensor], Tensor]
    """(views [..., V, U, C, H, W], slopes [N]) -> stack [..., N, C, H, W]."""
    planes: FocalPlanes | None = None
    """The only planes it makes, being a network; None: any, being a linear operator."""

    def stack(self, field: LightField, slopes: Tensor) -> Tensor:
        """Refocus a light field, where it lies.

        A linear operator counts samples by their weight; a network never saw weights and takes the views as they are.

        Args:
            field: The light field.
            slopes: In pixels per view step, [N].

        Returns:
            Stack, [N, C, H, W].
        """
        if self.planes is None:
            return weighted.refocus(self.refocus, field, slopes)
        return self.refocus(field.views, slopes)


def operators(choices: Mapping[str, Callable[[Tensor, Tensor], Tensor]]) -> list[Method]:
    """One method for each named operator setting."""
    return [Method(name, operator) for name, operator in choices.items()]


def network(path: str | Path, device: str | torch.device = "cpu") -> Method:
    """The method that a checkpoint holds, named after its run.

    Args:
        path: The checkpoint.
        device: Where it runs.

    Raises:
        CheckpointError: It cannot be read.
    """
    refocuser = checkpoint.load(path, device)
    return Method(run_name(Path(path)), for_its_planes(refocuser), refocuser.planes)


def for_its_planes(refocuser: Refocuser) -> Callable[[Tensor, Tensor], Tensor]:
    """A network as an operator that refuses other planes than it was trained for."""

    def refocus(views: Tensor, slopes: Tensor) -> Tensor:
        if slopes.shape != refocuser.slopes.shape or not torch.allclose(slopes.double(), refocuser.slopes, atol=1e-6):
            raise InputError(
                f"this network makes the planes alpha = {list(refocuser.alphas)}",
                got=f"slopes {[round(slope, 4) for slope in slopes.tolist()]}",
                remedy="leave alphas and planes as the network was trained",
            )
        return refocuser(views)

    return refocus


def run_name(path: Path) -> str:
    """Name of the run that a checkpoint belongs to: RUN/checkpoints/FILE.ckpt -> RUN; else the file's stem."""
    return path.resolve().parent.parent.name if path.resolve().parent.name == "checkpoints" else path.stem


def unique_names(methods: list[Method]) -> list[Method]:
    """The same methods, a number added to names that occur before."""
    named: dict[str, Method] = {}
    for method in methods:
        candidates = (method.name if count == 1 else f"{method.name} ({count})" for count in itertools.count(1))
        name = next(name for name in candidates if name not in named)
        named[name] = replace(method, name=name)
    return list(named.values())
