"""Networks that engines are measured on, each with simulated light fields and what a lens would have recorded of them.

Letters: `N` planes, `C H W` channel, pixel row and column.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from lfref.data.plane_sets import Recipe
from lfref.data.sources import SimulatedField
from lfref.engines.engine import Inputs, Job
from lfref.geometry import FocalPlanes
from lfref.nets.network import Network
from lfref.nets.refiner import Refiner
from lfref.refocuser.guides import Seen, guides

Read = Callable[[SimulatedField], Inputs]
"""What a network is given of a light field."""


class Shot(NamedTuple):
    """One light field, as a network gets it."""

    scene: str
    """Its name."""
    inputs: Inputs
    """What the network is given."""
    truth: Tensor
    """What a lens would have recorded, in linear light, [N, C, H, W]."""


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
        return Job(self.network, self.shots[0].inputs, self.patches)

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
    return _subject(name, network, fields, planes, is_trained, device, lambda field: (field.views,))


def of_refiner(
    name: str, refiner: Refiner, fields: Fields, planes: FocalPlanes, recipe: Recipe, is_trained: bool
) -> Subject:
    """A network that reads guides and pictures, on the CPU.

    Args:
        name: As tables call it.
        refiner: Trained, or else with layers that do something.
        fields: Of any grid of views.
        planes: What is refocused to.
        recipe: Says what pictures and guides are made by.
        is_trained: Whether it is.
    """

    def read(field: SimulatedField) -> Inputs:
        seen = Seen(field, planes.slopes, recipe.base)
        return guides(seen, recipe.guides), seen.pictures

    return _subject(name, refiner, fields, planes, is_trained, torch.device("cpu"), read)


@torch.no_grad()
def untrained_refiner(recipe: Recipe, field: SimulatedField, planes: FocalPlanes) -> Refiner:
    """A refiner for these guides whose last layers are not silent, as fast as a trained one.

    Args:
        recipe: Says which guides there are.
        field: Any, to count their channels.
        planes: Any.
    """
    seen = Seen(field, planes.slopes[:1], recipe.base)
    refiner = Refiner(guides(seen, recipe.guides).shape[-3], seen.pictures.shape[-3])
    for layer in refiner.modules():
        if isinstance(layer, nn.Conv2d):
            nn.init.kaiming_normal_(layer.weight)
    return refiner


@torch.no_grad()
def _subject(
    name: str,
    network: nn.Module,
    fields: Fields,
    planes: FocalPlanes,
    is_trained: bool,
    device: torch.device,
    read: Read,
) -> Subject:
    def there(inputs: Inputs) -> Inputs:
        return tuple(each.to(device).contiguous() for each in inputs)

    shots = [Shot(field.name, there(read(field)), field.photograph(planes.values)) for field in fields.whole]
    patches = [there(read(field)) for field in fields.patches]
    return Subject(name, network.eval().to(device), is_trained, shots, patches)
