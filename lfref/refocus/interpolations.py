"""Shifting views by fractions of a pixel along one axis: nearest, linear, cubic, exact.

A view is read at x + shift. Each interpolation adds a shifted view onto a running sum, so that nothing is stored
twice; `exact` is trigonometric (Fourier) interpolation. Source of `cubic`: Keys, "Cubic convolution interpolation for
digital image processing", 1981.
"""

import functools
import math
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import torch
from torch import Tensor

from lfref.functional import fourier
from lfref.refocus.borders import Border

Fraction = TypeVar("Fraction", float, Tensor)

Taps = Callable[[float], list[tuple[int, float]]]
"""(shift) -> samples around it, each as its offset and weight."""

SEAM = 16  # samples over which a view that is not periodic is faded into its other end before a Fourier shift


class Interpolation(NamedTuple):
    """One way to read a view between its samples."""

    snap: Callable[[float], float]
    """The shift that is really carried out for a wanted one."""
    extend: Callable[[Tensor, Border, int, int], tuple[Tensor, int]]
    """(view, border, reach, axis) -> the extended view, and how many samples were put before it."""
    add_shifted: Callable[[Tensor, Tensor, float, int, tuple[int, int], int], None]
    """(total, extended, shift, pad, span, axis): adds the shifted view to `total` within `span`, in place."""
    taps: Taps | None
    """The few samples that it reads; None: all of them."""


def _extend_locally(view: Tensor, border: Border, reach: int, axis: int) -> tuple[Tensor, int]:
    return border.extend(view, reach, axis), reach


def _linear_taps(shift: float) -> list[tuple[int, float]]:
    whole = math.floor(shift)
    fraction = shift - whole
    return [(whole, 1 - fraction), (whole + 1, fraction)]


def cubic_weights(t: Fraction) -> tuple[Fraction, Fraction, Fraction, Fraction]:
    """Weights of the samples at -1, 0, 1 and 2 for a position t between 0 and 1: Keys' kernel with a = -1/2.

    It is the a that reproduces quadratics.

    Args:
        t: A number, or a tensor of any shape.
    """
    return (
        -0.5 * t + t**2 - 0.5 * t**3,
        1 - 2.5 * t**2 + 1.5 * t**3,
        0.5 * t + 2 * t**2 - 1.5 * t**3,
        -0.5 * t**2 + 0.5 * t**3,
    )


def _cubic_taps(shift: float) -> list[tuple[int, float]]:
    whole = math.floor(shift)
    return [(whole + i - 1, weight) for i, weight in enumerate(cubic_weights(shift - whole))]


def _add_local(
    total: Tensor, extended: Tensor, shift: float, pad: int, span: tuple[int, int], axis: int, taps: Taps
) -> None:
    start, stop = span
    for offset, weight in taps(shift):
        # A weight of 0 must not touch its sample: at whole shifts it need not exist, and 0 * inf is NaN.
        if weight != 0:
            taken = extended.narrow(axis, pad + offset + start, stop - start)
            total.narrow(axis, start, stop - start).add_(taken, alpha=weight)


def _extend_periodically(view: Tensor, border: Border, reach: int, axis: int) -> tuple[Tensor, int]:
    """Extend so that the Fourier shift's own periodicity meets no jump (a jump would ring across the view)."""
    if border.is_periodic:
        return view, 0
    pad = reach + SEAM
    extended = border.extend(view, pad, axis).movedim(axis, -1).clone()
    fade = 0.5 - 0.5 * torch.cos(torch.linspace(0, torch.pi, 2 * SEAM + 2, dtype=torch.float64))[1:-1]
    fade = fade.to(view)
    before, after = extended[..., -SEAM - 1 :][..., :1], extended[..., SEAM : SEAM + 1]
    seam = before + (after - before) * fade
    extended[..., -SEAM:], extended[..., :SEAM] = seam[..., :SEAM], seam[..., SEAM:]
    return extended.movedim(-1, axis), pad


def _add_exact(total: Tensor, extended: Tensor, shift: float, pad: int, span: tuple[int, int], axis: int) -> None:
    start, stop = span
    length = extended.shape[axis]
    phases = fourier.shift_phases(fourier.half_frequencies(length), torch.tensor(shift, dtype=torch.float64))
    phases = phases.to(total.device, fourier.complex_dtype(total.dtype))
    spectrum = torch.fft.rfft(extended, dim=axis) * (phases if axis == -1 else phases[:, None])
    shifted = torch.fft.irfft(spectrum, n=length, dim=axis)
    total.narrow(axis, start, stop - start).add_(shifted.narrow(axis, pad + start, stop - start))


def _local(taps: Taps, snap: Callable[[float], float] = float) -> Interpolation:
    return Interpolation(snap, _extend_locally, functools.partial(_add_local, taps=taps), taps)


INTERPOLATIONS: dict[str, Interpolation] = {
    "nearest": _local(_linear_taps, snap=lambda shift: math.floor(shift + 0.5)),
    "linear": _local(_linear_taps),
    "cubic": _local(_cubic_taps),
    "exact": Interpolation(float, _extend_periodically, _add_exact, None),
}
