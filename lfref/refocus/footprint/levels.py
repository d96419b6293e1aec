"""Boxes whose width differs from pixel to pixel: between a few widths, one after the other, each pixel blends two.

Where a width lies between the levels is even in it, as a box's response is, and grows with its logarithm, as the
detail that a box leaves becomes coarser. Beside the box of the pixel's own width the response is off by at most 0.02
over k <= 0.4 along both axes, up to 8 samples, and by 0.0015 in the mean over a natural picture's spectrum (1/k^2).
Letters: `w` width in samples, `k` frequency in cycles per sample.
"""

import math

from torch import Tensor

PER_E_FOLD = 4  # levels while w^2 grows by e
NARROW = 2.0  # widths below it are blended by their square


def place(squared_widths: Tensor) -> Tensor:
    """Where widths lie among the levels: 2.25 is a quarter of the way from level 2 to level 3.

    Args:
        squared_widths: w^2, >= 0, any shape.
    """
    return PER_E_FOLD * (squared_widths / NARROW**2).log1p()


def width(level: int) -> float:
    """The width of a level, in samples; 0 of level 0."""
    return NARROW * math.sqrt(math.expm1(level / PER_E_FOLD))


def spanned(places: Tensor) -> range:
    """The levels that pixels at these places blend."""
    low, high = places.detach().aminmax()
    return range(math.floor(float(low)), math.ceil(float(high)) + 1)
