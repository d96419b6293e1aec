"""The tone curve: how linear radiance is encoded for a screen."""

from dataclasses import dataclass
from typing import ClassVar

from torch import Generator, Tensor

from lfref.encoding import CURVES, Encoding
from lfref.errors import chosen
from lfref.simulator import checks


@dataclass(frozen=True)
class ToneCurve:
    """How radiance is encoded."""

    name: ClassVar[str] = "tone_curve"
    needs: ClassVar[tuple[str, ...]] = ("balanced",)
    makes: ClassVar[str] = "views"

    curve: str = "linear"
    """A key of `CURVES`."""
    gamma: float = 2.2
    """Exponent of the curve `gamma`, [0.1, 10]."""

    def __post_init__(self) -> None:
        chosen("tone curve", self.curve, CURVES)
        checks.numbers("a tone curve's gamma", [self.gamma], 0.1, 10)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """Nothing changes where the curve is a straight line."""
        straight = self.curve == "linear" or (self.curve == "gamma" and self.gamma == 1)
        return "the curve is linear" if straight else None

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Encode; nothing is drawn."""
        return self.encoding.encode(views)

    @property
    def encoding(self) -> Encoding:
        """How encoded samples stand for light."""
        return Encoding(self.curve, self.gamma if self.curve == "gamma" else None)
