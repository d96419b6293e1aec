"""Reading an image between its samples and beyond its edges: one record for each interpolation and each border rule.

A compiled loop that reads many samples with fixed weights adds up eight stretches of a row in one pass (`set_taps`,
`add_taps`). A stretch is `total.size` samples of `rows` from a start on, so that a filter along the row, or along a
column of rows that lie one after the other, is a table of starts and weights. The sums are written out because Numba
vectorises plain sums of eight products, but not a loop over them.
Letters: `t` fraction of a sample.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from lfref.functional import fourier, splines
from lfref.functional.loops import LANES, compiled

ON_VIEW = 1e-9
"""Pixels beyond the outermost sample that still count as on it: what rounding of float64 positions can add, with room
for any size of picture, and far below what can be seen."""
FARTHEST = 1 / torch.finfo(torch.float64).eps
"""Positions beyond have no fraction left in float64, and soon no index in int64."""

Tap = tuple[Tensor, Tensor]
"""Index of a sample along one axis, and its weight, [P...] each."""


class Border(NamedTuple):
    """How views continue beyond their edge."""

    mode: str
    """What `torch.nn.functional.pad` calls it."""
    tap: Callable[[Tensor, Tensor, int], Tap]
    """(index, weight, length of the axis) -> a tap that exists."""
    counts_only_samples: bool = False
    """Samples beyond the edge are left out of the mean instead of replaced."""

    def span(self, shift: float, length: int) -> tuple[int, int]:
        """First and one-past-last output sample that a view counts for, shifted along an axis of this length."""
        if not self.counts_only_samples:
            return 0, length
        return max(0, math.ceil(-shift)), max(0, min(length, math.floor(length - 1 - shift) + 1))

    def indices(self, pad: int, length: int) -> Tensor:
        """Index of the sample at each position from -pad to length + pad; -1: black, int64, [length + 2 pad]."""
        positions = torch.arange(-pad, length + pad)
        index, weight = self.tap(positions, torch.ones_like(positions), length)
        return torch.where(weight > 0, index, -1)

    def extend(self, view: Tensor, pad: int, axis: int) -> Tensor:
        """Images [..., H, W] with `pad` more samples at both ends of axis -1 (columns) or -2 (rows)."""
        columns, rows = (pad, 0) if axis == -1 else (0, pad)
        # PyTorch pads the last two axes of a 4-D tensor in every mode.
        padded = F.pad(view.reshape(1, -1, *view.shape[-2:]), (columns, columns, rows, rows), mode=self.mode)
        return padded.reshape(*view.shape[:-2], *padded.shape[-2:])


def _replicated(index: Tensor, weight: Tensor, length: int) -> Tap:
    return index.clamp(min=0).clamp(max=length - 1), weight


def _black(index: Tensor, weight: Tensor, length: int) -> Tap:
    within = index.clamp(min=0).clamp(max=length - 1)
    return within, torch.where(within == index, weight, 0.0)


def _periodic(index: Tensor, weight: Tensor, length: int) -> Tap:
    return fourier.wrapped(index, length), weight


BORDERS: dict[str, Border] = {
    "renormalize": Border("replicate", _replicated, counts_only_samples=True),
    "edge": Border("replicate", _replicated),
    "zero": Border("constant", _black),
    "wrap": Border("circular", _periodic),
}


class Interpolation(NamedTuple):
    """One way to read an image between its samples."""

    weights: Callable
    """(t), a number or a tensor -> weights of consecutive samples around a position t beyond one."""
    before: int = 0
    """Samples before that one where the weights begin."""
    rounds: bool = False
    """Positions are rounded to whole samples first, halves upwards."""

    def snap(self, positions: Tensor) -> Tensor:
        """The positions that are read instead of requested ones."""
        return (positions + 0.5).floor() if self.rounds else positions

    def taps(self, position: float) -> list[tuple[int, float]]:
        """The few samples that are read, each as its index and weight."""
        whole = math.floor(position)
        weights = self.weights(position - whole)
        # What rounding leaves of a weight of 0 would be a sample beyond the farthest that is kept.
        return [(whole - self.before + i, weight if abs(weight) > 1e-12 else 0.0) for i, weight in enumerate(weights)]


INTERPOLATIONS: dict[str, Interpolation] = {
    "nearest": Interpolation(lambda t: (1 - t,), rounds=True),
    "linear": Interpolation(lambda t: (1 - t, t)),
    "cubic": Interpolation(splines.weights, before=1),
    "spline": Interpolation(splines.cardinal_weights, before=-splines.SAMPLES[0]),
}
CUBIC, SPLINE = INTERPOLATIONS["cubic"], INTERPOLATIONS["spline"]
"""The interpolations of methods without a setting."""


def is_sampled(shifts: Tensor, places: Tensor, length: int) -> Tensor:
    """Whether the position `place + shift` lies on the view, [0, length - 1]; shifts and places broadcast."""
    positions = places + shifts
    return (positions >= 0) & (positions <= length - 1)


TAPS = 8
"""Taps that one pass over a row adds up: more would leave no registers for their weights."""

Integers = NDArray[np.int64]
Reals = NDArray[np.floating]


def rounded_up(width: int) -> int:
    """A width rounded up to whole vectors, so that no loop ends in single steps."""
    return width + -width % LANES


@compiled
def set_taps(rows: Reals, starts: Integers, weights: Reals, total: Reals) -> None:
    """The weighted sum of `TAPS` stretches of `rows`, in one pass."""
    r0, r1, r2, r3 = rows[starts[0] :], rows[starts[1] :], rows[starts[2] :], rows[starts[3] :]
    r4, r5, r6, r7 = rows[starts[4] :], rows[starts[5] :], rows[starts[6] :], rows[starts[7] :]
    w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
    w4, w5, w6, w7 = weights[4], weights[5], weights[6], weights[7]
    for x in range(total.size):
        low = w0 * r0[x] + w1 * r1[x] + w2 * r2[x] + w3 * r3[x]
        total[x] = low + w4 * r4[x] + w5 * r5[x] + w6 * r6[x] + w7 * r7[x]


@compiled
def add_taps(rows: Reals, starts: Integers, weights: Reals, total: Reals) -> None:
    """The weighted sum of `TAPS` stretches of `rows`, added to `total`."""
    r0, r1, r2, r3 = rows[starts[0] :], rows[starts[1] :], rows[starts[2] :], rows[starts[3] :]
    r4, r5, r6, r7 = rows[starts[4] :], rows[starts[5] :], rows[starts[6] :], rows[starts[7] :]
    w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
    w4, w5, w6, w7 = weights[4], weights[5], weights[6], weights[7]
    for x in range(total.size):
        low = w0 * r0[x] + w1 * r1[x] + w2 * r2[x] + w3 * r3[x]
        total[x] += low + w4 * r4[x] + w5 * r5[x] + w6 * r6[x] + w7 * r7[x]
