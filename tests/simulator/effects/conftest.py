"""Shared by the tests of the effects: a grid of views, and effects applied with a seed."""

from torch import Tensor

from lfref.simulator.effects import effect
from lfref.simulator.effects.effect import Effect

GRID = (3, 2)
"""View rows and columns, where effects do not mind how many."""


def applied(one: Effect, views: Tensor, seed: int = 0) -> Tensor:
    """The views with one effect."""
    return one.apply(views, effect.generator(seed, one.name))
