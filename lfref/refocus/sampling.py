"""Reading an image between its samples, one record an interpolation, for whatever reads views.

Letters: `t` fraction of a sample.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.functional import splines

# PART borders
# What a view holds beyond its edge, one record a border rule, for whatever reads views.
#
# `renormalize` counts only the views that have a sample there; the others make a sample up.

LEFT_OUT, REPLICATED, BLACK, PERIODIC = range(4)
"""Numbers by which compiled loops know the rules."""
ON_VIEW = 1e-9
"""Pixels by which rounding may put a position beyond the outermost sample."""

Tap = tuple[Tensor, Tensor]
"""Index of a sample along one axis, and its weight, [P...] each."""


class Border(NamedTuple):
    """How views continue beyond their edge."""

    mode: str
    """What PyTorch's `pad` calls it."""
    tap: Callable[[Tensor, Tensor, int], Tap]
    """(index, weight, length of the axis) -> a tap that exists."""
    counts_only_samples: bool = False
    """Samples beyond the edge are left out of the sum instead of made up."""
    number: int | None = None
    """By which compiled loops know it; None: those that need one leave it to PyTorch."""

    @property
    def is_periodic(self) -> bool:
        """The continuation is the view itself, over and over."""
        return self.mode == "circular"

    def extend(self, view: Tensor, pad: int, axis: int) -> Tensor:
        """The view with `pad` more samples at both ends of an axis.

        Args:
            view: Images [..., H, W].
            pad: Samples to add at each end.
            axis: -1 (columns) or -2 (rows).
        """
        columns, rows = (pad, 0) if axis == -1 else (0, pad)
        # torch pads the last two axes of a 4-D tensor in every mode.
        padded = F.pad(view.reshape(1, -1, *view.shape[-2:]), (columns, columns, rows, rows), mode=self.mode)
        return padded.reshape(*view.shape[:-2], *padded.shape[-2:])


def _replicated(index: Tensor, weight: Tensor, length: int) -> Tap:
    return index.clamp(0, length - 1), weight


def _black(index: Tensor, weight: Tensor, length: int) -> Tap:
    within = index.clamp(0, length - 1)
    return within, torch.where(within == index, weight, 0.0)


def _periodic(index: Tensor, weight: Tensor, length: int) -> Tap:
    return index.remainder(length), weight


BORDERS: dict[str, Border] = {
    "renormalize": Border("replicate", _replicated, counts_only_samples=True, number=LEFT_OUT),
    "edge": Border("replicate", _replicated, number=REPLICATED),
    "zero": Border("constant", _black, number=BLACK),
    "wrap": Border("circular", _periodic, number=PERIODIC),
}


def sampled_span(shift: float, length: int) -> tuple[int, int]:
    """First and one-past-last output sample x whose position x + shift lies on the view, [0, length - 1].

    Args:
        shift: In samples.
        length: Samples along the axis.
    """
    return max(0, math.ceil(-shift)), max(0, min(length, math.floor(length - 1 - shift) + 1))


def sampled(shifts: list[float], length: int) -> Tensor:
    """Where each shifted view has a sample: 1 or 0, float64, [len(shifts), length]."""
    mask = torch.zeros(len(shifts), length, dtype=torch.float64)
    for row, shift in zip(mask, shifts, strict=True):
        start, stop = sampled_span(shift, length)
        row[start:stop] = 1
    return mask


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
    "cubic": Interpolation(splines.weights, before=1, number=CUBIC),
    "exact": Interpolation(None),
}
"""`exact` is trigonometric (Fourier) interpolation, which moves a whole view by one distance."""
