"""Shared by the tests of the effects: settings without surfaces, and effects applied with a seed."""

from dataclasses import dataclass

from torch import Tensor

from lfref.simulator.effects import effect
from lfref.simulator.effects.effect import Effect
from lfref.simulator.effects.sensor import Sensor


@dataclass(frozen=True)
class Grid:
    """What effects look at in a camera."""

    grid: tuple[int, int] = (3, 2)


@dataclass(frozen=True)
class Setting:
    """What effects look at in a scene."""

    sensor: Sensor = Sensor()  # noqa: RUF009  frozen
    camera: Grid = Grid()
    seed: int = 0


def applied(one: Effect, views: Tensor, seed: int = 0) -> Tensor:
    """The views with one effect."""
    return one.apply(views, effect.generator(seed, one.name))
