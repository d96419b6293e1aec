"""Effects of recording: exposure, mosaic, noise, limits and steps of samples, white balance and tone curve.

Mosaic: every pixel keeps one of its three colours. Each view has a mosaic of its own, as in a camera array; under the
lenslets of a single sensor the phase would change from view to view. Demosaicing is linear: bilinear
interpolation, corrected by the Laplacian of the colour that the pixel itself has.
Noise is normally distributed, of variance a x + b at radiance x, independent from sample to sample.
Sources: Malvar, He and Cutler, "High-quality linear interpolation for demosaicing of Bayer-patterned color images",
2004, Fig. 2; Foi et al., "Practical Poissonian-Gaussian noise modeling and fitting for single-image raw-data", 2008.
"""

import math
from dataclasses import dataclass

import torch
from torch import Generator, Tensor
from torch.nn import functional as F

from lfref.encoding import CURVES, Encoding
from lfref.errors import InputError, chosen
from lfref.simulator import checks
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
class Exposure(Effect):
    """One gain for the whole light field."""

    gain: float = 1.0  # factor of all radiances, [0, 1e4]

    def __post_init__(self) -> None:
        checks.numbers("an exposure's gain", [self.gain], 0, 1e4)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """The effect is inert at gain 1."""
        return "gain is 1" if self.gain == 1 else None

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Multiply by the gain."""
        return views * self.gain


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

    shot: float = 0.0  # variance a per unit of radiance, [0, 1]; 1 / a is the number of electrons at radiance 1
    read: float = 0.0  # variance b in the dark, [0, 1]

    def __post_init__(self) -> None:
        checks.numbers("a noise's shot and read", [self.shot, self.read], 0, 1)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """The effect is inert if the variance is 0."""
        return None if self.shot or self.read else "shot and read noise are 0"

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

    low: float = 0.0  # smallest value; -inf: no limit
    high: float = 1.0  # largest value; inf: no limit

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise InputError("a clipping needs a low limit below its high one", got=f"{self.low} and {self.high}")

    def inert(self, grid: tuple[int, int]) -> str | None:
        """The effect is inert without limits; whether radiances exceed them is not known before they are rendered."""
        return "there are no limits" if math.isinf(self.low) and math.isinf(self.high) else None

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Clamp to the range."""
        return views.clamp(self.low, self.high)


@dataclass(frozen=True)
class Quantisation(Effect):
    """Samples rounded to the steps of an analogue-digital converter."""

    bits: int | None = None  # 2^bits values from 0 to 1, [1, 20]; None: no rounding

    def __post_init__(self) -> None:
        # Float32 holds 24 bits, and scaling and rounding take some.
        if self.bits is not None:
            checks.numbers("quantisation bits", [self.bits], 1, 20)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """The effect is inert without a number of bits."""
        return None if self.bits else "samples are not rounded"

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Round to the nearest step; values beyond [0, 1] are rounded to steps of the same size."""
        if not self.bits:
            return views
        steps = 2**self.bits - 1
        return (views * steps).round() / steps


@dataclass(frozen=True)
class WhiteBalance(Effect):
    """One gain for each colour."""

    gains: tuple[float, ...] = (1.0, 1.0, 1.0)  # factors of red, green and blue, [0, 1e4]

    def __post_init__(self) -> None:
        checks.freeze(self)
        checks.colour("a white balance's gains", self.gains, 0, 1e4)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """The effect is inert if all gains are 1."""
        return "all gains are 1" if all(gain == 1 for gain in self.gains) else None

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Multiply every channel by its gain."""
        return views * torch.tensor(self.gains).to(views)[:, None, None]


@dataclass(frozen=True)
class ToneCurve(Effect):
    """The encoding of radiance for a screen."""

    curve: str = "linear"  # A key of `lfref.encoding.CURVES`
    gamma: float = 2.2  # exponent of the curve `gamma`, [0.1, 10]

    def __post_init__(self) -> None:
        chosen("tone curve", self.curve, CURVES)
        checks.numbers("a tone curve's gamma", [self.gamma], 0.1, 10)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """The effect is inert if the curve is a straight line."""
        is_straight = self.curve == "linear" or (self.curve == "gamma" and self.gamma == 1)
        return "the curve is linear" if is_straight else None

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Encode the views by the curve."""
        return self.encoding.encode(views)

    @property
    def encoding(self) -> Encoding:
        """The curve as an encoding, which also decodes the views."""
        return Encoding(self.curve, self.gamma if self.curve == "gamma" else None)
