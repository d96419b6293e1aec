"""Apertures with an area: each view stands for a cell of the aperture, `fill` view steps wide, instead of a point.

Within the cell light of disparity d moves by |s - d| pixels a view step, so that a plane is the sum of points blurred
by a box of `fill |s - d|` pixels along x and along y. It is the same for all views: a filter of the finished plane.
Letters: `s` slope and `d` disparity in pixels per view step.
Sources: Isaksen et al., "Dynamically reparameterized light fields", 2000; Stewart et al., "A new reconstruction filter
for undersampled light fields", 2003.
"""

import functools
import math
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.refocus import batches

# PART box
# The taps of a box of any width: what light that moves evenly over some pixels leaves on the samples of a picture.
#
# Inside, a sample counts 1 / w; at each end five taps are free, and those that best give the box's own response
# sinc(w k) are taken, each frequency counting by the power 1 / k^2 of a natural picture. At all widths to 16 it is
# met to
# 0.035 over k <= 0.4, to 0.009 over k <= 0.3, and to 0.0005 in the mean over such a picture. (A box over cubic
# interpolation, with as many taps, is off by 0.12 and 0.09.)
# Letters: `w` width in samples, `k` frequency in cycles per sample, `n` sample, counted from the middle.

ENDS = 5  # taps at each end that are fitted
BAND = 0.4  # frequencies up to which the response has to be right, in cycles per sample
ABOVE = 0.01  # what power above the band counts beside power within: it keeps the response from growing there
N_FREQUENCIES = 200  # at which the response is compared: many times as many as taps are free


@functools.lru_cache(maxsize=1024)
def taps(width: float) -> tuple[float, ...]:
    """Weights of the samples around a pixel, of sum 1, the same to both sides; only the pixel itself at width 0.

    Args:
        width: Of the box, in samples, finite and >= 0.

    Returns:
        `2 radius(width) + 1` weights.
    """
    n = torch.arange(radius(width) + 1, dtype=torch.float64)
    if len(n) == 1:
        return (1.0,)
    times = torch.where(n == 0, 1.0, 2.0)  # that a weight stands in the filter
    inner, ends = n[:-ENDS], slice(max(0, len(n) - ENDS), None)
    rest = 1 - float(times[: len(inner)].sum()) / width
    fitted = _fitted(n, times, ends, width, rest)
    half = [1 / width] * len(inner) + fitted.tolist()
    return (*half[:0:-1], *half)


def radius(width: float) -> int:
    """Samples to each side that a box reads."""
    return math.ceil(width / 2) + 1 if width > 0 else 0


def response(widths: Tensor, frequencies: Tensor) -> Tensor:
    """What a box itself does to frequencies.

    Args:
        widths: In samples, [...].
        frequencies: In cycles per sample, [K].

    Returns:
        sinc(w k), [..., K].
    """
    return torch.sinc(widths[..., None] * frequencies)


def _fitted(n: Tensor, times: Tensor, ends: slice, width: float, rest: float) -> Tensor:
    """The free weights, together `rest`: least squares under one condition, by its multiplier."""
    k = (torch.arange(N_FREQUENCIES, dtype=torch.float64) + 0.5) / (2 * N_FREQUENCIES)
    waves = times * torch.cos(2 * torch.pi * k[:, None] * n)
    free, fixed = waves[:, ends], waves[:, : ends.start].sum(1) / width
    counts = (torch.where(k < BAND, 1.0, ABOVE) / k.square())[:, None]
    system = torch.zeros(free.shape[1] + 1, free.shape[1] + 1, dtype=torch.float64)
    system[:-1, :-1] = free.T @ (counts * free)
    system[-1, :-1] = system[:-1, -1] = times[ends]
    wanted = (free.T @ (counts * (torch.sinc(width * k) - fixed)[:, None]))[:, 0]
    return torch.linalg.solve(system, torch.cat([wanted, wanted.new_tensor([rest])]))[:-1]


# PART levels
# Boxes whose width differs from pixel to pixel: between a few widths, one after the other, each pixel blends two.
#
# Where a width lies between the levels is even in it, as a box's response is, and grows with its logarithm, as the
# detail that a box leaves becomes coarser. Beside the box of the pixel's own width the response is off by at most 0.02
# over k <= 0.4 along both axes, up to 8 samples, and by 0.0015 in the mean over a natural picture's spectrum (1/k^2).
# Letters: `w` width in samples, `k` frequency in cycles per sample.

PER_E_FOLD = 4  # levels while w^2 grows by e
NARROW = 2.0  # widths below it are blended by their square


def place(squared_widths: Tensor) -> Tensor:
    """Where widths lie among the levels: 2.25 is a quarter of the way from level 2 to level 3.

    Args:
        squared_widths: w^2, >= 0, any shape.
    """
    return PER_E_FOLD * (squared_widths / NARROW**2).log1p()


def width(level: int) -> float:
    """The width of a level, in samples; 0 of level 0."""
    return NARROW * math.sqrt(math.expm1(level / PER_E_FOLD))


def spanned(places: Tensor) -> range:
    """The levels that pixels at these places blend."""
    low, high = places.detach().aminmax()
    return range(math.floor(float(low)), math.ceil(float(high)) + 1)


class Footprint(NamedTuple):
    """What a view's cell covers of the picture."""

    fill: float
    """Side of a cell in view steps, >= 0; 0: views are points, and planes the plain sums."""
    disparity: Tensor
    """Of what the pixels show: a single number, or one for each pixel where the views are, [B or 1, 1, H, W]."""
    size: tuple[int, int]
    """Height and width of a view in pixels."""

    def varies(self, slopes: Tensor) -> bool:
        """Whether some planes' blur differs from pixel to pixel, at slopes as of `widths`."""
        return self.disparity.ndim > 0 or slopes.ndim > 1

    def widths(self, slopes: Tensor) -> Tensor:
        """Widths of the boxes in pixels.

        Args:
            slopes: Of the planes, [N], or of all their pixels, [N, H, W]; float64.

        Returns:
            With their sign, [N], or [B or 1, N, H, W] if they vary.

        Raises:
            InputError: A box that is wider than the picture.
        """
        planes = slopes.reshape(1, len(slopes), *slopes.shape[1:] or (1, 1)) if self.varies(slopes) else slopes
        disparity = self.disparity
        widths = self.fill * (planes.to(disparity) - disparity if disparity.ndim else planes - float(disparity))
        if (widest := float(torch.stack(widths.detach().aminmax()).abs().max())) > max(self.size):
            raise InputError(
                f"fill * |slope - disparity| must be at most the picture's {max(self.size)} px",
                got=f"{widest:g} px",
                remedy="disparity is in pixels per view step, as slopes are",
            )
        return widths.expand(-1, -1, *self.size) if widths.ndim > 1 else widths

    def responses(self, slopes: Tensor, frequencies: Tensor) -> Tensor:
        """What the cells do to frequencies along one axis; all pass where the blur varies, which comes after.

        Args:
            slopes: Of the planes, [N], float64.
            frequencies: In cycles per pixel, [K].

        Returns:
            Real factors, [N, 1, K].
        """
        widths = torch.zeros_like(slopes) if self.varies(slopes) else self.widths(slopes)
        return response(widths, frequencies)[:, None]


def checked(fill: float, disparity: float | Tensor, views: Tensor) -> Footprint:
    """The footprint of the views' cells, once its numbers are known to be usable.

    Args:
        fill: Side of a cell in view steps, finite and >= 0.
        disparity: Finite, in pixels per view step: a number, or a map [H, W], or one for each light field, [..., H, W].
        views: Light fields, [..., V, U, C, H, W].

    Raises:
        InputError: Numbers that are not finite, a negative `fill`, or a map of another shape.
    """
    size = (views.shape[-2], views.shape[-1])
    if not (isinstance(fill, int | float) and math.isfinite(fill) and fill >= 0):
        raise InputError("fill must be finite and >= 0, in view steps", got=repr(fill), remedy="1 fills the aperture")
    return Footprint(float(fill), _checked_disparity(disparity, views, size), size)


def _checked_disparity(disparity: float | Tensor, views: Tensor, size: tuple[int, int]) -> Tensor:
    values = torch.as_tensor(disparity, dtype=torch.float64)
    if tuple(values.shape) not in ((), size, (*views.shape[:-5], *size)):
        raise InputError(
            f"disparity must be a number or a map {list(size)}, or one map for each light field",
            got=f"shape {list(values.shape)}",
            remedy="resize the map to the views",
        )
    if not bool(values.detach().isfinite().all()):
        raise InputError("disparity must be finite", remedy="fill its gaps, torch.nan_to_num(disparity)")
    if values.ndim == 0:
        return values.detach().cpu()
    return values.to(views.device, batches.working_dtype(views.dtype)).reshape(-1, 1, *size)
