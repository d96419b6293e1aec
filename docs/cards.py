"""Flat cards before the cameras, each shifted exactly in the Fourier domain: `scenes` draws on them.

Letters: `v u` view row and column. `L[v, u](x, y) = f(x - d (u - u0), y - d (v - v0))` for a card of disparity d.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from lfref import geometry
from lfref.functional import fourier


class Card(NamedTuple):
    """One flat surface that faces the cameras."""

    disparity: float
    """Pixels per view step."""
    colour: Tensor
    """Radiance in [0, 1], [3, H, W]."""
    opacity: Tensor
    """Matte in [0, 1], [1, H, W]."""


def views(cards: Sequence[Card], grid: tuple[int, int], margin: int) -> Tensor:
    """Views of cards, far to near, without the margin around them, [V, U, 3, H, W]."""
    picture = torch.zeros(())
    for card in cards:
        seen = _shifted(card, grid)
        picture = seen[:, :, :3] + picture * (1 - seen[:, :, 3:])
    return picture[..., margin:-margin, margin:-margin].clamp(0, 1).contiguous()


def grain(seed: int, size: tuple[int, int]) -> Tensor:
    """Noise whose spectrum falls with the frequency, of unit standard deviation, [1, H, W]."""
    radius = (torch.fft.fftfreq(size[0])[:, None].square() + torch.fft.rfftfreq(size[1]).square()).sqrt()
    gain = radius.clamp(min=1 / max(size)) ** -0.7 * ((0.5 - radius) / 0.15).clamp(0, 1) * (radius > 0)
    white = torch.randn(1, *size, generator=torch.Generator().manual_seed(seed))
    noise = torch.fft.irfft2(torch.fft.rfft2(white) * gain, s=size)
    return noise / noise.std()


def _shifted(card: Card, grid: tuple[int, int]) -> Tensor:
    """Premultiplied colour and opacity of a card in every view, [V, U, 4, H, W]."""
    surface = torch.cat([card.colour * card.opacity, card.opacity])
    height, width = surface.shape[-2:]
    vertical, horizontal = (-card.disparity * geometry.angular_offsets(n_views) for n_views in grid)
    rows = fourier.shift_phases(fourier.frequencies(height), vertical).to(torch.complex64)
    columns = fourier.shift_phases(fourier.half_frequencies(width), horizontal).to(torch.complex64)
    spectrum = torch.fft.rfft2(surface) * columns[:, None, None]
    return torch.stack([torch.fft.irfft2(spectrum * row[:, None], s=(height, width)) for row in rows])
