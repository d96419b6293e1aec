"""What a view holds beyond its edge, one record a border rule.

`renormalize` counts only the views that have a sample there; the others make a sample up.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F


class Border(NamedTuple):
    """How views continue beyond their edge."""

    extend: Callable[[Tensor, int, int], Tensor]
    """(view, pad, axis) -> the view with `pad` more samples at both ends of that axis."""
    counts_only_samples: bool = False
    """Samples beyond the edge are left out of the sum instead of made up."""
    is_periodic: bool = False
    """The continuation is the view itself, over and over."""


def _pad(view: Tensor, pad: int, axis: int, mode: str) -> Tensor:
    columns, rows = (pad, 0) if axis == -1 else (0, pad)
    # torch pads the last two axes of a 4-D tensor in every mode.
    padded = F.pad(view.reshape(1, -1, *view.shape[-2:]), (columns, columns, rows, rows), mode=mode)
    return padded.reshape(*view.shape[:-2], *padded.shape[-2:])


def replicate(view: Tensor, pad: int, axis: int) -> Tensor:
    """Repeat the outermost sample.

    Args:
        view: Images [..., H, W].
        pad: Samples to add at each end.
        axis: -1 (columns) or -2 (rows).
    """
    return _pad(view, pad, axis, "replicate")


def circular(view: Tensor, pad: int, axis: int) -> Tensor:
    """Continue with the opposite end; arguments as in `replicate`."""
    return _pad(view, pad, axis, "circular")


def zeros(view: Tensor, pad: int, axis: int) -> Tensor:
    """Continue with black; arguments as in `replicate`."""
    return _pad(view, pad, axis, "constant")


BORDERS: dict[str, Border] = {
    "renormalize": Border(replicate, counts_only_samples=True),
    "edge": Border(replicate),
    "zero": Border(zeros),
    "wrap": Border(circular, is_periodic=True),
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
