"""Interpolation kernels for reading a spectrum between its bins, and what they do to the views.

Reading a spectrum with kernel c multiplies the views by the transform of c, so the views are divided by it first;
leaving that out makes the picture turn brighter with the slope.
Letters: `t` distance in bins, `W` kernel width in bins, `sigma` oversampling (padded over original size).
Source: Beatty, Nishimura, Pauly, "Rapid gridding reconstruction with a minimal oversampling ratio", 2005, eq. 5.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.errors import InputError


class Kernel(NamedTuple):
    """A kernel and its transform."""

    width: int
    """Bins that it spans."""
    weight: Callable[[Tensor], Tensor]
    """Value at a distance in bins."""
    transform: Callable[[Tensor], Tensor]
    """What the views are divided by, at a position as a share of the padded aperture, in [-1/2, 1/2]."""


def linear(width: int, sigma: float) -> Kernel:
    """Linear interpolation between the two nearest bins, as in Ng 2005; interpolates, so it divides by nothing.

    Args:
        width: Ignored: linear interpolation spans two bins.
        sigma: Ignored.
    """
    return Kernel(2, lambda t: (1 - t.abs()).clamp(min=0), torch.ones_like)


def kaiser_bessel(width: int, sigma: float) -> Kernel:
    """The Kaiser-Bessel kernel with Beatty's beta.

    Args:
        width: Bins that it spans, >= 2.
        sigma: Oversampling, >= 1.

    Raises:
        InputError: Width below 2 or oversampling below 1.
    """
    if width < 2 or sigma < 1:
        raise InputError("a Kaiser-Bessel kernel needs width >= 2 and padding >= 1", got=f"{width} and {sigma:g}")
    beta = math.pi * math.sqrt((width / sigma) ** 2 * (sigma - 0.5) ** 2 - 0.8) if width > 1.8 else 0.0

    def weight(t: Tensor) -> Tensor:
        inside = (1 - (2 * t / width) ** 2).clamp(min=0)
        # At the jump at its ends the kernel counts half, on both sides alike.
        share = torch.heaviside(width / 2 - t.abs(), torch.tensor(0.5, dtype=t.dtype))
        return share * torch.special.i0(beta * inside.sqrt()) / width

    def transform(position: Tensor) -> Tensor:
        root = torch.complex(beta**2 - (math.pi * width * position) ** 2, torch.zeros_like(position)).sqrt()
        return torch.where(root.abs() < 1e-8, torch.ones_like(position), (root.sinh() / root).real)

    return Kernel(width, weight, transform)


KERNELS: dict[str, Callable[[int, float], Kernel]] = {"linear": linear, "kaiser_bessel": kaiser_bessel}
