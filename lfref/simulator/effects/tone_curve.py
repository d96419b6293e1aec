"""The tone curve: how linear radiance is encoded for a screen.

Below 0 every curve is continued so that nothing is undefined. Source of `srgb`: IEC 61966-2-1, 1999.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Generator, Tensor

from lfref.errors import chosen
from lfref.simulator import checks


def srgb(radiance: Tensor, gamma: float) -> Tensor:
    """Encode for a standard screen; `gamma` is not used.

    Args:
        radiance: Linear, any shape.
        gamma: Not used.
    """
    return torch.where(radiance <= 0.0031308, 12.92 * radiance, 1.055 * radiance.clamp(min=1e-3) ** (1 / 2.4) - 0.055)


def from_srgb(encoded: Tensor, gamma: float) -> Tensor:
    """Undo `srgb`; `gamma` is not used.

    Args:
        encoded: For a standard screen, any shape.
        gamma: Not used.
    """
    return torch.where(encoded <= 0.04045, encoded / 12.92, ((encoded.clamp(min=0.04) + 0.055) / 1.055) ** 2.4)


def power(values: Tensor, exponent: float) -> Tensor:
    """Raise to a power, negative values as their mirror image.

    Args:
        values: Any shape.
        exponent: Above 0.
    """
    # The power of 0 is 0, but its slope need not be finite.
    size = values.abs()
    return torch.where(size > 0, values.sign() * size.clamp(min=1e-30) ** exponent, 0.0)


class Curve(NamedTuple):
    """A tone curve and its inverse, functions of values and the exponent `gamma`."""

    encode: Callable[[Tensor, float], Tensor]
    decode: Callable[[Tensor, float], Tensor]


CURVES: dict[str, Curve] = {
    "linear": Curve(lambda radiance, gamma: radiance, lambda encoded, gamma: encoded),
    "srgb": Curve(srgb, from_srgb),
    "gamma": Curve(lambda radiance, gamma: power(radiance, 1 / gamma), power),
}


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
        return CURVES[self.curve].encode(views, self.gamma)

    def undo(self, views: Tensor) -> Tensor:
        """Linear values of encoded ones.

        Args:
            views: Any shape.
        """
        return CURVES[self.curve].decode(views, self.gamma)
