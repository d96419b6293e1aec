"""The Bayer mosaic, and the demosaicing that undoes it.

Every pixel of every view keeps one of its three colours. Each view has a mosaic of its own, as in a camera array; under
the lenslets of a single sensor the phase would change from view to view.
Demosaicing is linear: bilinear interpolation, corrected by the Laplacian of the colour that the pixel itself has.
Source: Malvar, He and Cutler, "High-quality linear interpolation for demosaicing of Bayer-patterned color images",
2004, Fig. 2.
"""

from dataclasses import dataclass

import torch
from torch import Generator, Tensor
from torch.nn import functional as F

from lfref.errors import InputError, chosen
from lfref.simulator.effects import Effect

PATTERNS: dict[str, tuple[tuple[int, int], tuple[int, int]]] = {
    "RGGB": ((0, 1), (1, 2)),
    "BGGR": ((2, 1), (1, 0)),
    "GRBG": ((1, 0), (2, 1)),
    "GBRG": ((1, 2), (0, 1)),
}
"""Channel of each pixel of the top-left block of 2 x 2, row by row."""

# Filters in eighths. CROSS: green at red or blue. ACROSS: red or blue at a green pixel with this colour to its left and
# right. CORNERS: red at blue, or blue at red.
CROSS = ((0, 0, -1, 0, 0), (0, 0, 2, 0, 0), (-1, 2, 4, 2, -1), (0, 0, 2, 0, 0), (0, 0, -1, 0, 0))
ACROSS = ((0, 0, 0.5, 0, 0), (0, -1, 0, -1, 0), (-1, 4, 5, 4, -1), (0, -1, 0, -1, 0), (0, 0, 0.5, 0, 0))
CORNERS = ((0, 0, -1.5, 0, 0), (0, 2, 0, 2, 0), (-1.5, 0, 6, 0, -1.5), (0, 2, 0, 2, 0), (0, 0, -1.5, 0, 0))


@dataclass(frozen=True)
class Mosaic(Effect):
    """One colour per pixel."""

    pattern: str | None = "RGGB"  # A key of `PATTERNS`; None: three colours per pixel

    def __post_init__(self) -> None:
        if self.pattern is not None:
            chosen("mosaic pattern", self.pattern, PATTERNS)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """The effect is inert without a pattern."""
        return None if self.pattern else "every pixel sees three colours"

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Keep one colour of every pixel."""
        return mosaicked(views, self.pattern) if self.pattern else views


@dataclass(frozen=True)
class Demosaic(Effect):
    """Three colours per pixel again. A sensor with a mosaic applies this effect by itself."""

    pattern: str | None = "RGGB"  # pattern of the mosaic, which has checked it

    def inert(self, grid: tuple[int, int]) -> str | None:
        """The effect is inert without a mosaic."""
        return None if self.pattern else "there is no mosaic"

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Interpolate the other two colours."""
        return demosaicked(views, self.pattern) if self.pattern else views


def mosaicked(views: Tensor, pattern: str) -> Tensor:
    """One colour of every pixel, [..., 1, H, W], of views [..., 3, H, W] of at least 3 x 3 pixels."""
    if min(views.shape[-2:]) < 3:
        size = "x".join(map(str, views.shape[-2:]))
        raise InputError("a mosaic needs views of at least 3x3 pixels", got=size)
    raw = views.new_empty(*views.shape[:-3], 1, *views.shape[-2:])
    for row, channels in enumerate(PATTERNS[pattern]):
        for column, channel in enumerate(channels):
            raw[..., 0, row::2, column::2] = views[..., channel, row::2, column::2]
    return raw


def demosaicked(raw: Tensor, pattern: str) -> Tensor:
    """All colours, [..., 3, H, W], of the samples of a mosaic, [..., 1, H, W], at least 3 x 3 pixels."""
    # Mirrored about the outermost sample, the picture keeps the phase of the mosaic beyond its edge.
    pictures = F.pad(raw.reshape(-1, 1, *raw.shape[-2:]), (2, 2, 2, 2), mode="reflect")
    # On a GPU a float32 convolution may round its inputs to ten bits (TF32).
    pictures = pictures.double() if pictures.is_cuda else pictures
    views = raw.new_empty(len(pictures), 3, *raw.shape[-2:])
    for row, channels in enumerate(PATTERNS[pattern]):
        for column, channel in enumerate(channels):
            # Only the pixels of this phase: the filters step by two.
            weight = _filters(channel, PATTERNS[pattern][row][1 - column]).to(pictures)
            views[..., row::2, column::2] = F.conv2d(pictures[..., row:, column:], weight[:, None], stride=2)
    return views.reshape(*raw.shape[:-3], 3, *raw.shape[-2:])


def _filters(own: int, beside: int) -> Tensor:
    """Filters for red, green and blue at a pixel of colour `own` with `beside` to its left and right, [3, 5, 5]."""
    cross, across, corners = (torch.tensor(eighths) / 8 for eighths in (CROSS, ACROSS, CORNERS))
    identity = F.pad(torch.ones(1, 1), (2, 2, 2, 2))
    others = {beside: across, 2 - beside: across.T} if own == 1 else {1: cross, 2 - own: corners}
    return torch.stack([others.get(channel, identity) for channel in range(3)])
