"""Networks that engines are measured on, each with simulated light fields and what a lens would have recorded of them.

Letters: `N` planes, `C H W` channel, pixel row and column.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from lfref.data.sources import SimulatedField
from lfref.engines.engine import Inputs, Job, Run
from lfref.geometry import FocalPlanes
from lfref.nets.network import Network
from lfref.refocuser import guides, refined
from lfref.refocuser.refined import RefinedRefocuser
from lfref.refocuser.seen import Seen


class Shot(NamedTuple):
    """One light field, as a network gets it."""

    scene: str
    """Its name."""
    parts: Sequence[Inputs]
    """What the network is given, one after the other, all of one shape."""
    truth: Tensor
    """What a lens would have recorded, in linear light, [N, C, H, W]."""

    def stack(self, run: Run) -> Tensor:
        """What a network makes of it, [N, C, H, W].

        Args:
            run: The network.
        """
        made = [run(*part) for part in self.parts]
        return made[0] if len(made) == 1 else torch.cat(made)


@dataclass(frozen=True, eq=False)
class Subject:
    """A network and what it is measured on."""

    name: str
    """As tables call it."""
    network: nn.Module
    """In evaluation mode."""
    is_trained: bool
    """Whether its pictures are to be judged by truth: without training they show nothing."""
    shots: Sequence[Shot]
    """At least one, all of one size."""
    patches: Sequence[Inputs]
    """Of other scenes, by which whole numbers are scaled."""

    @property
    def job(self) -> Job:
        """As engines take it."""
        return Job(self.network, self.shots[0].parts[0], self.patches)

    @property
    def device(self) -> torch.device:
        """Where it runs."""
        return self.job.device


class Fields(NamedTuple):
    """Simulated light fields."""

    whole: Sequence[SimulatedField]
    """What engines are timed and judged on."""
    patches: Sequence[SimulatedField]
    """Small ones, by which whole numbers are scaled."""


@torch.no_grad()
def of_network(
    name: str, network: Network, fields: Fields, planes: FocalPlanes, is_trained: bool, device: torch.device
) -> Subject:
    """A network that reads views.

    Args:
        name: As tables call it.
        network: Trained, or else its last layer is set so that its pictures are as bright as these scenes.
        fields: With its grid of views.
        planes: Those that it makes.
        is_trained: Whether it is.
        device: Where it runs.
    """
    if not is_trained:
        first = fields.patches[0]
        network.prime(first.views[None], planes.slopes, first.photograph(planes.values)[None])
    whole = [(field, [(field.views.to(device),)]) for field in fields.whole]
    shots = [Shot(field.name, parts, field.photograph(planes.values)) for field, parts in whole]
    patches = [(field.views.to(device),) for field in fields.patches]
    return Subject(name, network.eval().to(device), is_trained, shots, patches)


@torch.no_grad()
def of_refiner(refiner: RefinedRefocuser, fields: Fields, planes: FocalPlanes, device: torch.device) -> Subject:
    """The network of a method that is refined; it is given as many planes at once as in use.

    Args:
        refiner: Trained.
        fields: Of any grid of views.
        planes: What is refocused to.
        device: Where the network runs.
    """
    n_samples = int(refiner.refiner.config["n_guides"]) * math.prod(fields.whole[0].size)
    n_at_once = _at_once(n_samples, len(planes))

    def parts(field: SimulatedField) -> list[Inputs]:
        seen = Seen(field, planes.slopes, refiner.base)
        split = [(guides.guides(part, refiner.names), part.pictures, part.doubt) for part in seen.parts(n_at_once)]
        return [tuple(each.to(device).contiguous() for each in part) for part in split]

    shots = [Shot(field.name, parts(field), field.photograph(planes.values)) for field in fields.whole]
    patches = [part for field in fields.patches for part in parts(field)]
    return Subject(refiner.name, refiner.refiner.to(device), True, shots, patches)


def _at_once(n_samples: int, n_planes: int) -> int:
    """Planes that the network is given at once, all parts alike: an engine is prepared for one shape."""
    most = max(1, refined.AT_ONCE // n_samples)
    return max(count for count in range(1, n_planes + 1) if n_planes % count == 0 and count <= most)
