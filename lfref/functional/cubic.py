"""Cubic convolution: the weights that read a signal between its samples.

Source: Keys, "Cubic convolution interpolation for digital image processing", 1981.
"""

from typing import TypeVar

from torch import Tensor

Fraction = TypeVar("Fraction", float, Tensor)


def weights(t: Fraction) -> tuple[Fraction, Fraction, Fraction, Fraction]:
    """Weights of the samples at -1, 0, 1 and 2 for a position t between 0 and 1: Keys' kernel with a = -1/2.

    It is the a that reproduces quadratics.

    Args:
        t: A number, also within a compiled loop, or a tensor of any shape.
    """
    return (
        -0.5 * t + t**2 - 0.5 * t**3,
        1 - 2.5 * t**2 + 1.5 * t**3,
        0.5 * t + 2 * t**2 - 1.5 * t**3,
        -0.5 * t**2 + 0.5 * t**3,
    )
