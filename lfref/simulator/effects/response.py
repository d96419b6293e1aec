"""The tone curve: how linear radiance is encoded for a screen."""

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Generator, Tensor

from lfref.encoding import CURVES, Encoding
from lfref.errors import InputError, chosen
from lfref.simulator import checks

# PART exposure
# Exposure: one gain for the whole light field.


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


# PART white_balance
# White balance: one gain for each colour.


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


# PART clipping
# Clipping: what a sample cannot hold is cut off.


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


# PART quantisation
# Quantisation: samples are rounded to the steps of an analogue-digital converter.

MOST_BITS = 20  # float32 holds 24


@dataclass(frozen=True)
class Quantisation:
    """How many steps a sample has."""

    name: ClassVar[str] = "quantisation"
    needs: ClassVar[tuple[str, ...]] = ("clipped",)
    makes: ClassVar[str] = "quantised"

    bits: int | None = None
    """2^bits values from 0 to 1, [1, 20]; None: as fine as floating point."""

    def __post_init__(self) -> None:
        whole = isinstance(self.bits, int) and not isinstance(self.bits, bool)
        if self.bits is not None and not (whole and 1 <= self.bits <= MOST_BITS):
            raise InputError(f"quantisation bits must be a whole number from 1 to {MOST_BITS}", got=repr(self.bits))

    def inert(self, grid: tuple[int, int]) -> str | None:
        """Nothing changes without a number of bits."""
        return None if self.bits else "samples are not rounded"

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """See `quantised`; nothing is drawn."""
        return quantised(views, self.bits) if self.bits else views


def quantised(views: Tensor, bits: int) -> Tensor:
    """Round to the nearest step; values beyond [0, 1] are rounded to steps of the same size.

    Args:
        views: Radiance, any shape.
        bits: 2^bits values from 0 to 1.
    """
    steps = 2**bits - 1
    return (views * steps).round() / steps


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
