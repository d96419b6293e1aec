"""Effects that act on every sample alike: exposure, white balance, clipping, quantisation, tone curve."""

import math
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from lfref.encoding import CURVES, Encoding
from lfref.errors import InputError, chosen
from lfref.simulator import checks
from lfref.simulator.effects import Effect


@dataclass(frozen=True)
class Exposure(Effect):
    """One gain for the whole light field."""

    gain: float = 1.0  # factor of all radiances, [0, 1e4]

    def __post_init__(self) -> None:
        checks.numbers("an exposure's gain", [self.gain], 0, 1e4)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """The effect is inert at gain 1."""
        return "gain is 1" if self.gain == 1 else None

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Multiply by the gain."""
        return views * self.gain


@dataclass(frozen=True)
class Clipping(Effect):
    """The range that samples are clamped to."""

    low: float = 0.0  # smallest value; -inf: no limit
    high: float = 1.0  # largest value; inf: no limit

    def __post_init__(self) -> None:
        are_numbers = all(isinstance(limit, int | float) for limit in (self.low, self.high))
        if not (are_numbers and self.low < self.high):
            raise InputError("a clipping needs a low limit below its high one", got=f"{self.low} and {self.high}")

    def inert(self, grid: tuple[int, int]) -> str | None:
        """The effect is inert without limits; whether radiances exceed them is not known before they are rendered."""
        return "there are no limits" if math.isinf(self.low) and math.isinf(self.high) else None

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Clamp to the range."""
        return views.clamp(self.low, self.high)


@dataclass(frozen=True)
class Quantisation(Effect):
    """Samples rounded to the steps of an analogue-digital converter."""

    bits: int | None = None  # 2^bits values from 0 to 1, [1, 20]; None: no rounding

    def __post_init__(self) -> None:
        # Float32 holds 24 bits, and scaling and rounding take some.
        is_whole = isinstance(self.bits, int) and not isinstance(self.bits, bool)
        if self.bits is not None and not (is_whole and 1 <= self.bits <= 20):
            raise InputError("quantisation bits must be a whole number from 1 to 20", got=repr(self.bits))

    def inert(self, grid: tuple[int, int]) -> str | None:
        """The effect is inert without a number of bits."""
        return None if self.bits else "samples are not rounded"

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Round to the nearest step; values beyond [0, 1] are rounded to steps of the same size."""
        if not self.bits:
            return views
        steps = 2**self.bits - 1
        return (views * steps).round() / steps


@dataclass(frozen=True)
class WhiteBalance(Effect):
    """One gain for each colour."""

    gains: tuple[float, ...] = (1.0, 1.0, 1.0)  # factors of red, green and blue, [0, 1e4]

    def __post_init__(self) -> None:
        checks.freeze(self)
        checks.colour("a white balance's gains", self.gains, 0, 1e4)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """The effect is inert if all gains are 1."""
        return "all gains are 1" if all(gain == 1 for gain in self.gains) else None

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Multiply every channel by its gain."""
        return views * torch.tensor(self.gains).to(views)[:, None, None]


@dataclass(frozen=True)
class ToneCurve(Effect):
    """The encoding of radiance for a screen."""

    curve: str = "linear"  # A key of `lfref.encoding.CURVES`
    gamma: float = 2.2  # exponent of the curve `gamma`, [0.1, 10]

    def __post_init__(self) -> None:
        chosen("tone curve", self.curve, CURVES)
        checks.numbers("a tone curve's gamma", [self.gamma], 0.1, 10)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """The effect is inert if the curve is a straight line."""
        is_straight = self.curve == "linear" or (self.curve == "gamma" and self.gamma == 1)
        return "the curve is linear" if is_straight else None

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Encode the views by the curve."""
        return self.encoding.encode(views)

    @property
    def encoding(self) -> Encoding:
        """The curve as an encoding, which also decodes the views."""
        return Encoding(self.curve, self.gamma if self.curve == "gamma" else None)
