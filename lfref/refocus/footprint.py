"""Apertures with an area: each view stands for a cell of the aperture, `fill` view steps wide, instead of a point.

Within the cell light of disparity d moves by |s - d| pixels a view step, so that a plane is the sum of points blurred
by a box of w = fill |s - d| pixels along x and along y. It is the same for all views: a filter of the finished plane.
As taps, a sample inside the box counts 1 / w; five taps at each end are fitted to the box's own response sinc(w k),
each frequency counting by the power 1 / k^2 of a natural picture. For all widths to 16 the response is met to 0.035
over k <= 0.4, to 0.009 over k <= 0.3. (A box over cubic interpolation, with as many taps, is off by 0.12 and 0.09.)
Where the width differs from pixel to pixel, a few widths (levels) are computed and each pixel blends two: off by at
most 0.02 over k <= 0.4 up to w = 8, and by 0.0015 in the mean over a natural picture's spectrum.
Letters: `s` slope and `d` disparity in pixels per view step, `w` width in samples, `k` frequency in cycles per sample,
`n` sample counted from the middle.
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

ENDS = 5
"""Taps fitted at each end of a box; fewer miss the errors above, more would only cost."""
BAND = 0.4
"""Highest frequency at which the response has to be right, in cycles per sample."""
PER_E_FOLD = 4
"""Levels while w^2 grows by a factor of e; fewer miss the errors above, more would only cost."""
NARROW = 2.0
"""Width in samples below which levels are even in w^2, as a box's response is; above they are even in log w. Less would
only cost."""


@functools.lru_cache(maxsize=1024)
def taps(width: float) -> tuple[float, ...]:
    """Weights of the `2 radius(width) + 1` samples around a pixel, of sum 1, for a box `width` >= 0 samples wide."""
    n = torch.arange(radius(width) + 1, dtype=torch.float64)
    if len(n) == 1:
        return (1.0,)
    times = torch.where(n == 0, 1.0, 2.0)  # how often a weight stands in the symmetric filter
    n_inner, ends = max(0, len(n) - ENDS), slice(max(0, len(n) - ENDS), None)
    # Least squares for the end taps under one condition, the sum 1, by its Lagrange multiplier.
    k = (torch.arange(200, dtype=torch.float64) + 0.5) / 400  # so fine that more frequencies change nothing
    waves = times * torch.cos(2 * torch.pi * k[:, None] * n)
    free, fixed = waves[:, ends], waves[:, :n_inner].sum(1) / width
    # Above the band little weight keeps the response from growing.
    power = (torch.where(k < BAND, 1.0, 0.01) / k.square())[:, None]
    system = torch.zeros(free.shape[1] + 1, free.shape[1] + 1, dtype=torch.float64)
    system[:-1, :-1] = free.T @ (power * free)
    system[-1, :-1] = system[:-1, -1] = times[ends]
    goal = (free.T @ (power * (torch.sinc(width * k) - fixed)[:, None]))[:, 0]
    rest = 1 - float(times[:n_inner].sum()) / width
    fitted = torch.linalg.solve(system, torch.cat([goal, goal.new_tensor([rest])]))[:-1]
    half = [1 / width] * n_inner + fitted.tolist()
    return (*half[:0:-1], *half)


def radius(width: float) -> int:
    """Samples to each side that a box reads."""
    return math.ceil(width / 2) + 1 if width > 0 else 0


def response(widths: Tensor, frequencies: Tensor) -> Tensor:
    """What boxes of these widths [...] do to frequencies [K] in cycles per sample: sinc(w k), [..., K]."""
    return torch.sinc(widths[..., None] * frequencies)


def place(squared_widths: Tensor) -> Tensor:
    """Position of widths, given as w^2, among the levels: 2.25 is a quarter of the way from level 2 to level 3."""
    return PER_E_FOLD * (squared_widths / NARROW**2).log1p()


def width(level: int) -> float:
    """The width of a level in samples, the inverse of `place`."""
    return NARROW * math.sqrt(math.expm1(level / PER_E_FOLD))


def spanned(places: Tensor) -> range:
    """The levels that pixels at these places blend."""
    low, high = places.detach().aminmax()
    return range(math.floor(float(low)), math.ceil(float(high)) + 1)


class Footprint(NamedTuple):
    """The pixels that a view's cell covers."""

    fill: float
    """Side of a cell in view steps, >= 0; 0: views are points, and planes the plain sums."""
    disparity: Tensor
    """Of the scene: a single number, or one for each pixel where the views are, [B or 1, 1, H, W]."""
    size: tuple[int, int]
    """Height and width of a view in pixels."""

    def varies(self, slopes: Tensor) -> bool:
        """Whether the blur of planes at slopes [N] or [N, H, W] differs from pixel to pixel."""
        return self.disparity.ndim > 0 or slopes.ndim > 1

    def widths(self, slopes: Tensor) -> Tensor:
        """Signed widths of the boxes in pixels for slopes [N] or [N, H, W]: [N], or [B or 1, N, H, W] if they vary.

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
        """Real factors of the frequencies along one axis, [N, 1, K]; 1 where the blur varies and comes afterwards."""
        widths = torch.zeros_like(slopes) if self.varies(slopes) else self.widths(slopes)
        return response(widths, frequencies)[:, None]


def checked(fill: float, disparity: float | Tensor, views: Tensor) -> Footprint:
    """The footprint of the cells of views [..., V, U, C, H, W].

    Raises:
        InputError: Numbers that are not finite, a negative `fill`, or a map of disparities of another shape.
    """
    size = (views.shape[-2], views.shape[-1])
    if not (isinstance(fill, int | float) and math.isfinite(fill) and fill >= 0):
        raise InputError("fill must be finite and >= 0, in view steps", got=repr(fill), remedy="1 fills the aperture")
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
        return Footprint(float(fill), values.detach().cpu(), size)
    maps = values.to(views.device, batches.working_dtype(views.dtype)).reshape(-1, 1, *size)
    return Footprint(float(fill), maps, size)
