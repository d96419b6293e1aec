"""What every effect is: plain numbers, the results it needs and makes, when it changes nothing, and what it does.

An effect's random numbers come from the scene's seed and its own name alone, so that they are the same whichever other
effects run. They are drawn on the CPU: the same on every device.
"""

from typing import ClassVar, Protocol

import numpy as np
import torch
from torch import Generator, Tensor


class Effect(Protocol):
    """A frozen dataclass of plain numbers that says what it does to the views."""

    name: ClassVar[str]
    """As it is called in a scene's sensor and in explanations."""
    needs: ClassVar[tuple[str, ...]]
    """Names of the results that it takes; the first is passed on where it is inert."""
    makes: ClassVar[str]
    """Name of the result that it makes."""

    def inert(self, grid: tuple[int, int]) -> str | None:
        """Why it changes nothing in this many view rows and columns; None where it may change something."""

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Views with the effect; see the effect's own function for their axes."""


def generator(seed: int, name: str) -> Generator:
    """The source of an effect's random numbers.

    Args:
        seed: The scene's, at least 0.
        name: The effect's.
    """
    # The name itself, not a place in a list: another effect must not change what this one draws.
    key = np.random.SeedSequence((seed, int.from_bytes(name.encode(), "big"))).generate_state(1, np.uint64)
    return Generator().manual_seed(int(key[0]))


def normal(shape: tuple[int, ...], generator: Generator, like: Tensor) -> Tensor:
    """Draw from the standard normal distribution.

    Args:
        shape: Of the draws.
        generator: On the CPU.
        like: Whose type and device the draws take on.
    """
    return torch.randn(shape, generator=generator).to(like)
