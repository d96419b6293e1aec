"""Quantisation: samples are rounded to the steps of an analogue-digital converter."""

from dataclasses import dataclass
from typing import ClassVar

from torch import Generator, Tensor

from lfref.errors import InputError

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
