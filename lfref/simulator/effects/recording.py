"""Effects of recording: exposure, mosaic, noise, limits and steps of samples, white balance and tone curve.

Mosaic: every pixel keeps one of its three colours. Each view has a mosaic of its own, as in a camera array; under the
lenslets of a single sensor the phase would change from view to view. Demosaicing is linear: bilinear
interpolation, corrected by the Laplacian of the colour that the pixel itself has.
Noise is normally distributed, of variance a x + b at radiance x, independent from sample to sample.
Sources: Malvar, He and Cutler, "High-quality linear interpolation for demosaicing of Bayer-patterned color images",
2004, Fig. 2; Foi et al., "Practical Poissonian-Gaussian noise modeling and fitting for single-image raw-data", 2008.
"""

from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Generator, Tensor
from torch.nn import functional as F

from lfref.encoding import CURVES, Encoding
from lfref.errors import InputError, chosen
from lfref.simulator import checks
from lfref.simulator.effects import Effect

Gain = Annotated[float, 0, 1e4]
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
class Exposure(Effect):
    """One gain for the whole light field."""

    gain: Gain = 1.0  # factor of all radiances

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Multiply by the gain."""
        return views * self.gain


@dataclass(frozen=True)
class Mosaic(Effect):
    """One colour per pixel."""

    pattern: str = "RGGB"  # a key of `PATTERNS`

    def __post_init__(self) -> None:
        super().__post_init__()
        chosen("mosaic pattern", self.pattern, PATTERNS)

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Keep one colour of every pixel."""
        return mosaicked(views, self.pattern)


@dataclass(frozen=True)
class Demosaic(Effect):
    """Three colours per pixel again. A sensor with a mosaic applies this effect by itself."""

    pattern: str  # of the mosaic

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Interpolate the other two colours."""
        return demosaicked(views, self.pattern)


def mosaicked(views: Tensor, pattern: str) -> Tensor:
    """One colour of every pixel, [..., 1, H, W], of views [..., 3, H, W] of at least 3 x 3 pixels."""
    raw = views.new_empty(*views.shape[:-3], 1, *views.shape[-2:])
    for row, channels in enumerate(PATTERNS[pattern]):
        for column, channel in enumerate(channels):
            raw[..., 0, row::2, column::2] = views[..., channel, row::2, column::2]
    return raw


def demosaicked(raw: Tensor, pattern: str) -> Tensor:
    """All colours, [..., 3, H, W], of the samples of a mosaic, [..., 1, H, W], at least 3 x 3 pixels."""
    # Mirrored about the outermost sample, the picture keeps the phase of the mosaic beyond its edge.
    pictures = F.pad(raw.reshape(-1, 1, *raw.shape[-2:]), (2, 2, 2, 2), mode="reflect")
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


@dataclass(frozen=True)
class Noise(Effect):
    """Noise of the sensor's samples."""

    shot: checks.Share = 0.0  # variance a per unit of radiance; 1 / a is the number of electrons at radiance 1
    read: checks.Share = 0.0  # variance b in the dark

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Add noise."""
        return noisy(views, self.shot, self.read, torch.randn(tuple(views.shape), generator=generator).to(views))


def noisy(views: Tensor, shot: float, read: float, draws: Tensor) -> Tensor:
    """Radiance of any shape plus noise from standard normal `draws`; below 0, the noise is the same as at 0."""
    variance = views.clamp(min=0) * shot + read
    # The root has no finite gradient at 0: the variance is at least 1e-20, and the root of that, 1e-10, is subtracted.
    return views + draws * (variance.clamp(min=1e-20).sqrt() - 1e-20**0.5)


@dataclass(frozen=True)
class Clipping(Effect):
    """The range that samples are clamped to."""

    low: float = 0.0  # smallest value
    high: float = 1.0  # largest value

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low < self.high:
            raise InputError("a clipping needs a low limit below its high one", got=f"{self.low} and {self.high}")

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Clamp to the range."""
        return views.clamp(self.low, self.high)


@dataclass(frozen=True)
class Quantisation(Effect):
    """Samples rounded to the steps of an analogue-digital converter."""

    bits: Annotated[int, 1, 20]
    """There are 2^bits values from 0 to 1. Float32 holds 24 bits, and scaling and rounding take some."""

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Round to the nearest step; values beyond [0, 1] are rounded to steps of the same size."""
        steps = 2**self.bits - 1
        return (views * steps).round() / steps


@dataclass(frozen=True)
class WhiteBalance(Effect):
    """One gain for each colour."""

    gains: tuple[Gain, Gain, Gain] = (1.0, 1.0, 1.0)  # factors of red, green and blue

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Multiply every channel by its gain."""
        return views * torch.tensor(self.gains).to(views)[:, None, None]


@dataclass(frozen=True)
class ToneCurve(Effect):
    """The encoding of radiance for a screen."""

    curve: str = "linear"  # a key of `lfref.encoding.CURVES`
    gamma: Annotated[float, 0.1, 10] = 2.2  # exponent of the curve `gamma`

    def __post_init__(self) -> None:
        super().__post_init__()
        chosen("tone curve", self.curve, CURVES)

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Encode the views by the curve."""
        return self.encoding.encode(views)

    @property
    def encoding(self) -> Encoding:
        """The curve as an encoding, which also decodes the views."""
        return Encoding(self.curve, self.gamma if self.curve == "gamma" else None)
