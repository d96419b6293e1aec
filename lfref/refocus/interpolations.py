"""Reading an image between its samples, one record an interpolation, for whatever reads views.

Letters: `t` fraction of a sample.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

from lfref.functional import cubic

NEAREST, LINEAR, CUBIC = range(3)
"""Numbers by which compiled loops know them."""
FARTHEST = 2.0**50
"""Positions beyond have no fraction left, and soon no index."""


class Interpolation(NamedTuple):
    """One way to read an image between its samples."""

    weights: Callable | None
    """(t), a number or a tensor -> weights of samples side by side, read t beyond one of them; None: all are read."""
    before: int = 0
    """Samples before that one where the weights begin."""
    rounds: bool = False
    """Whether positions are rounded to whole samples first, halves upwards."""
    number: int | None = None
    """By which compiled loops know it; None: those that need one leave it to PyTorch."""

    def snap(self, position: float) -> float:
        """The position that is really read for a wanted one."""
        return math.floor(position + 0.5) if self.rounds else position

    def taps(self, position: float) -> list[tuple[int, float]]:
        """The few samples that are read, each as its index and weight."""
        assert self.weights is not None, "this interpolation reads all samples"
        whole = math.floor(position)
        return [(whole - self.before + i, weight) for i, weight in enumerate(self.weights(position - whole))]


INTERPOLATIONS: dict[str, Interpolation] = {
    "nearest": Interpolation(lambda t: (1 - t,), rounds=True, number=NEAREST),
    "linear": Interpolation(lambda t: (1 - t, t), number=LINEAR),
    "cubic": Interpolation(cubic.weights, before=1, number=CUBIC),
    "exact": Interpolation(None),
}
"""`exact` is trigonometric (Fourier) interpolation, which moves a whole view by one distance."""
