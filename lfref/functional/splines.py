"""Cubic interpolation: splines through images (`coefficients`) or samples (`cardinal_weights`), and cubic convolution
(`weights`).

Splines are sharper between samples than cubic convolution, at the price of a pass over the image beforehand, or of more
samples.
Sources: Unser, "Splines: A Perfect Fit for Signal and Image Processing", 1999; Keys, "Cubic convolution interpolation
for digital image processing", 1981.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from lfref.functional.loops import compiled

POLE = 3**0.5 - 2
"""Pole of the recursive filter that turns samples into coefficients."""


def coefficients(images: NDArray[np.float32], in_place: bool = False) -> NDArray[np.float32]:
    """Coefficients of the splines through images [K, H, W], which are mirrored at their outermost samples."""
    result = images if in_place else images.copy()
    for image in result:
        _filter_columns(image)
        # Rows become columns of a copy: that takes a quarter of the time of a filter along rows.
        turned = np.ascontiguousarray(image.T)
        _filter_columns(turned)
        image[:] = turned.T
    return result


@compiled
def _filter_columns(image: NDArray[np.float32]) -> None:
    """Filter each column in place, forwards, then backwards; a step handles a whole row."""
    height, width = image.shape
    if height < 2:
        return
    # The forward pass starts with the mirrored samples before the first sample; after 16 of them the powers of the pole
    # are below float32's precision.
    period, power = 2 * height - 2, 1.0
    first = np.zeros(width)
    for y in range(16):
        place = y % period
        row = image[place if place < height else period - place]
        for x in range(width):
            first[x] += power * row[x]
        power *= POLE
    for x in range(width):
        image[0, x] = 6 * first[x]
    for y in range(1, height):
        for x in range(width):
            image[y, x] = 6 * image[y, x] + POLE * image[y - 1, x]
    for x in range(width):
        image[height - 1, x] = POLE / (POLE * POLE - 1) * (image[height - 1, x] + POLE * image[height - 2, x])
    for y in range(height - 2, -1, -1):
        for x in range(width):
            image[y, x] = POLE * (image[y + 1, x] - image[y, x])


Fraction = TypeVar("Fraction", float, Tensor)


def weights(t: Fraction) -> tuple[Fraction, Fraction, Fraction, Fraction]:
    """Keys's weights of the samples at -1, 0, 1 and 2 for a position t between 0 and 1, a number or a tensor.

    His parameter a is -1/2, the value that reproduces quadratics.
    """
    rest, square = 1 - t, t * t
    first, second, last = -0.5 * t * rest * rest, 1 + square * (1.5 * t - 2.5), -0.5 * square * rest
    return first, second, 1 - first - second - last, last


SAMPLES = range(-3, 5)
"""Samples that `cardinal_weights` reads."""
EXACT = np.linalg.pinv(np.vander(SAMPLES, 4, increasing=True).T).tolist()
"""Least changes of the weights of `SAMPLES` by which their moments 0 to 3 grow by 1, [8, 4]."""


def cardinal_weights(t: Fraction) -> tuple[Fraction, ...]:
    """Weights of `SAMPLES` in the cubic spline at a position t from 0 to 1, a number or a tensor.

    Samples farther away count for next to nothing; the others make up for them, so that cubics stay exact.
    """
    rest = 1 - t
    # The spline is the sum of bumps at -1, 0, 1 and 2; a sample counts in each of them by a power of the pole.
    bumps = (rest**3, 4 - 6 * t * t + 3 * t**3, 4 - 6 * rest * rest + 3 * rest**3, t**3)
    gain = -POLE / (1 - POLE * POLE)
    weights = [gain * sum(bump * POLE ** abs(m - place) for place, bump in enumerate(bumps, -1)) for m in SAMPLES]
    missing = [t**k - sum(weight * m**k for m, weight in zip(SAMPLES, weights, strict=True)) for k in range(4)]
    return tuple(
        weight + sum(share * moment for share, moment in zip(shares, missing, strict=True))
        for weight, shares in zip(weights, EXACT, strict=True)
    )
