"""Pictures as a part of one period of a periodic one, with room for what shifts beyond the border.

Without room opposite borders mix wherever views shift; in the room the outermost pixels go on.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.errors import chosen
from lfref.functional import fourier

SPARE = 2  # pixels beyond the reach, for what a kernel blurs


class Frame(NamedTuple):
    """Where a picture lies in its period."""

    size: tuple[int, int]
    """Height and width (H, W) of the picture."""
    first: tuple[int, int]
    """Row and column of its first pixel in the period."""
    period: tuple[int, int]
    """Height and width (h, w) of the period."""

    def extended(self, pictures: Tensor) -> Tensor:
        """Periods [..., h, w] that hold the pictures [..., H, W]."""
        if self.period == self.size:
            return pictures
        (height, width), (top, left) = self.period, self.first
        sides = (left, width - left - self.size[1], top, height - top - self.size[0])
        padded = F.pad(pictures.reshape(1, -1, *self.size), sides, mode="replicate")
        return padded.reshape(*pictures.shape[:-2], *self.period)

    def pictures(self, spectra: Tensor) -> Tensor:
        """Pictures [..., H, W] in periods with these spectra [..., h, w // 2 + 1]."""
        (top, left), (height, width) = self.first, self.size
        return torch.fft.irfft2(spectra, s=self.period)[..., top : top + height, left : left + width]


def _wrap(size: tuple[int, int], reach: float) -> Frame:
    """The picture is the period."""
    return Frame(size, (0, 0), size)


def _edge(size: tuple[int, int], reach: float) -> Frame:
    """Room for the reach at every side, as much more as makes FFTs fast."""
    height, width = (fourier.next_fast_length(length + 2 * (int(reach) + SPARE)) for length in size)
    return Frame(size, ((height - size[0]) // 2, (width - size[1]) // 2), (height, width))


BORDERS: dict[str, Callable[[tuple[int, int], float], Frame]] = {"edge": _edge, "wrap": _wrap}


def framed(border: str, size: tuple[int, int], reach: float) -> Frame:
    """The frame of pictures.

    Args:
        border: `edge`: beyond the border the outermost pixel goes on; `wrap`: the opposite border follows.
        size: Height and width (H, W).
        reach: Largest shift in pixels.

    Raises:
        InputError: Another border.
    """
    return chosen("border", border, BORDERS)(size, reach)
