"""Clipping: what a sample cannot hold is cut off."""

import math
from dataclasses import dataclass
from typing import ClassVar

from torch import Generator, Tensor

from lfref.errors import InputError


@dataclass(frozen=True)
class Clipping:
    """The range of the samples."""

    name: ClassVar[str] = "clipping"
    needs: ClassVar[tuple[str, ...]] = ("noisy",)
    makes: ClassVar[str] = "clipped"

    low: float = 0.0
    """Smallest value; -inf: none."""
    high: float = 1.0
    """Largest value; inf: none."""

    def __post_init__(self) -> None:
        are_numbers = all(isinstance(limit, int | float) for limit in (self.low, self.high))
        if not (are_numbers and self.low < self.high):
            raise InputError("a clipping needs a low limit below its high one", got=f"{self.low} and {self.high}")

    def inert(self, grid: tuple[int, int]) -> str | None:
        """Nothing changes without limits; that radiances keep within them is not known beforehand."""
        return "there are no limits" if math.isinf(self.low) and math.isinf(self.high) else None

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Clamp; nothing is drawn."""
        return views.clamp(self.low, self.high)
