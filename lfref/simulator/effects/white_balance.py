"""White balance: one gain for each colour."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Generator, Tensor

from lfref.simulator import checks


@dataclass(frozen=True)
class WhiteBalance:
    """Gains that make white white."""

    name: ClassVar[str] = "white_balance"
    needs: ClassVar[tuple[str, ...]] = ("demosaicked",)
    makes: ClassVar[str] = "balanced"

    gains: tuple[float, ...] = (1.0, 1.0, 1.0)
    """Factors on red, green and blue, [0, 1e4]."""

    def __post_init__(self) -> None:
        checks.freeze(self)
        checks.colour("a white balance's gains", self.gains, 0, 1e4)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """Nothing changes where all gains are 1."""
        return "all gains are 1" if all(gain == 1 for gain in self.gains) else None

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Multiply every channel; nothing is drawn."""
        return views * torch.tensor(self.gains).to(views)[:, None, None]
