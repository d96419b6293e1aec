"""The Bayer mosaic: every pixel of every view keeps one of its three colours.

Each view has a mosaic of its own, as in a camera array; under the lenslets of a single sensor the phase would change
from view to view.
"""

from dataclasses import dataclass
from typing import ClassVar

from torch import Generator, Tensor

from lfref.errors import InputError, chosen

PATTERNS: dict[str, tuple[tuple[int, int], tuple[int, int]]] = {
    "RGGB": ((0, 1), (1, 2)),
    "BGGR": ((2, 1), (1, 0)),
    "GRBG": ((1, 0), (2, 1)),
    "GBRG": ((1, 2), (0, 1)),
}
"""Channel of each pixel of the top-left block of 2 x 2, row by row."""


@dataclass(frozen=True)
class Mosaic:
    """One colour a pixel; the demosaicing that belongs to it follows after quantisation."""

    name: ClassVar[str] = "mosaic"
    needs: ClassVar[tuple[str, ...]] = ("exposed",)
    makes: ClassVar[str] = "mosaicked"

    pattern: str | None = "RGGB"
    """A key of `PATTERNS`; None: three colours a pixel."""

    def __post_init__(self) -> None:
        if self.pattern is not None:
            chosen("mosaic pattern", self.pattern, PATTERNS)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """Nothing changes where every pixel sees three colours."""
        return None if self.pattern else "every pixel sees three colours"

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """See `mosaicked`; nothing is drawn."""
        return mosaicked(views, self.pattern) if self.pattern else views


def mosaicked(views: Tensor, pattern: str) -> Tensor:
    """Keep one colour of every pixel.

    Args:
        views: Radiance, [..., 3, H, W], at least 3 x 3 pixels.
        pattern: A key of `PATTERNS`.

    Returns:
        The samples, [..., 1, H, W].

    Raises:
        InputError: The views are too small.
    """
    if min(views.shape[-2:]) < 3:
        got = "x".join(map(str, views.shape[-2:]))
        raise InputError("a mosaic needs views of at least 3x3 pixels", got=got)
    raw = views.new_empty(*views.shape[:-3], 1, *views.shape[-2:])
    for row, channels in enumerate(PATTERNS[pattern]):
        for column, channel in enumerate(channels):
            raw[..., 0, row::2, column::2] = views[..., channel, row::2, column::2]
    return raw
