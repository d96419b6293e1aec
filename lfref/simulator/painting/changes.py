"""Steps in which layers are painted: passes that leave out the surfaces that they would not change."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch

from lfref.simulator.painting import extents
from lfref.simulator.painting.layers import Layer, hides
from lfref.simulator.planner import Pass
from lfref.simulator.scene import Scene, Surface


@dataclass(frozen=True)
class Order:
    """What is to be painted, and for what."""

    scene: Scene
    device: torch.device
    reach: float
    """Greatest |slope|, in pixels per view step, that the layers will be refocused at."""

    @functools.cached_property
    def from_far_to_near(self) -> tuple[int, ...]:
        """Places of all surfaces in the scene's list, sorted by their mean disparity."""
        size = self.scene.camera.size
        shapes = [surface.geometry for surface in self.scene.surfaces]
        return tuple(sorted(range(len(shapes)), key=lambda place: sum(shapes[place].disparity_range(size))))

    @functools.cached_property
    def shown(self) -> tuple[int, ...]:
        """Places of the surfaces that no nearer one hides all over, from wherever they are looked at."""
        order = self.from_far_to_near
        return tuple(
            far for rank, far in enumerate(order) if not any(self._hides(near, far) for near in order[rank + 1 :])
        )

    @functools.cached_property
    def crossing(self) -> frozenset[int]:
        """Places of the surfaces shown that are before another one at some point, and behind it at another."""
        shapes = [self.surface(place).geometry for place in self.shown]
        pairs = extents.crossing(shapes, self.scene.camera, self.reach)
        return frozenset(self.shown[rank] for pair in pairs for rank in pair)

    def surface(self, place: int) -> Surface:
        """The surface at a place of the scene's list."""
        return self.scene.surfaces[place]

    def _hides(self, near: int, far: int) -> bool:
        one, other = self.surface(near), self.surface(far)
        return hides(one) and extents.is_before(one.geometry, other.geometry, self.scene.camera, self.reach)


class Change(NamedTuple):
    """One change of layers."""

    name: str
    needs: str
    """Name of the layers that it takes."""
    makes: str
    """Name of the layers that it makes."""
    make: Callable[[Order, Layer], Layer]
    is_idle: Callable[[Order, int], bool]
    """Whether it would leave the surface at a place of the scene's list as it is."""
    why: str
    """Said where it would leave all of them."""

    def planned(self, order: Order, force: bool = False) -> Pass:
        """The change as a pass.

        Args:
            order: What it works on.
            force: Change layers too that stay as they are.
        """
        reason = self.why if all(self.is_idle(order, place) for place in order.shown) else None
        return Pass(self.name, (self.needs,), self.makes, functools.partial(self._changed, order, force), reason)

    def _changed(self, order: Order, force: bool, layers: Sequence[Layer]) -> list[Layer]:
        return [self.make(order, layer) if force or not self.is_idle(order, layer.place) else layer for layer in layers]
