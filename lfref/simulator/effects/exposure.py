"""Exposure: one gain for the whole light field."""

from dataclasses import dataclass
from typing import ClassVar

from torch import Generator, Tensor

from lfref.simulator import checks


@dataclass(frozen=True)
class Exposure:
    """Brighter or darker."""

    name: ClassVar[str] = "exposure"
    needs: ClassVar[tuple[str, ...]] = ("mixed",)
    makes: ClassVar[str] = "exposed"

    gain: float = 1.0
    """Factor on all radiances, [0, 1e4]."""

    def __post_init__(self) -> None:
        checks.numbers("an exposure's gain", [self.gain], 0, 1e4)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """Nothing changes at gain 1."""
        return "gain is 1" if self.gain == 1 else None

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Multiply; nothing is drawn."""
        return views * self.gain
