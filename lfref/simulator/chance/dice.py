"""Numbers of random scenes, drawn from a generator: ranges, shares, colours, places."""

from collections.abc import Sequence
from typing import TypeVar

import torch
from torch import Generator

from lfref.simulator.scene import Camera
from lfref.simulator.textures import Colour

Thing = TypeVar("Thing")

Range = tuple[float, float]
"""Least and greatest number to draw."""


class Dice:
    """Numbers drawn from a generator.

    Args:
        generator: Source of randomness.
    """

    def __init__(self, generator: Generator) -> None:
        self.generator = generator

    def uniform(self, low: float = 0.0, high: float = 1.0) -> float:
        """A number between two others."""
        return low + (high - low) * float(torch.rand((), generator=self.generator))

    def whole(self, low: int, high: int) -> int:
        """A whole number from one to another, both included."""
        return int(torch.randint(low, high + 1, (), generator=self.generator))

    def one_of(self, things: Sequence[Thing]) -> Thing:
        """Any of some things, all alike."""
        return things[self.whole(0, len(things) - 1)]

    def happens(self, share: float) -> bool:
        """Whether what happens in that share of all cases happens; what never does takes no number."""
        return share > 0 and self.uniform() < share

    def chosen(self, shares: Sequence[float]) -> int | None:
        """The place of one of several cases that exclude each other, or None; impossible ones take no number.

        Args:
            shares: Of each case, 0 to 1, together 1 at most.
        """
        if not any(shares):
            return None
        at = self.uniform()
        return next((place for place in range(len(shares)) if at < sum(shares[: place + 1])), None)

    def colour(self, low: float, high: float) -> Colour:
        """Red, green and blue, each between two numbers."""
        return self.uniform(low, high), self.uniform(low, high), self.uniform(low, high)

    def within(self, camera: Camera) -> tuple[float, float]:
        """A point of the central view, from its centre."""
        height, width = camera.size
        return self.uniform(-width / 2, width / 2), self.uniform(-height / 2, height / 2)


class Tone:
    """How bright and how colourful a scene is as a whole, as photographs are.

    Args:
        brightness: Factor of all colours.
        saturation: 1 keeps colours, 0 leaves grey.
    """

    def __init__(self, brightness: float, saturation: float) -> None:
        self.brightness = brightness
        self.saturation = saturation

    def __call__(self, colour: Colour) -> Colour:
        """The colour as it is in such a scene."""
        grey = sum(colour) / 3
        red, green, blue = (self.brightness * (grey + self.saturation * (value - grey)) for value in colour)
        return red, green, blue
