"""How time grows: each method on fields of several sizes, and the exponent p of `t ~ n^p` along each axis.

One axis at a time is changed: pixels of a view, views, planes. The fastest run is fitted, not the median: whatever
else a machine does only adds time, so that with few runs the fastest is the nearest to the cost.
"""

import functools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from lfref import geometry
from lfref.bench import timing
from lfref.errors import InputError
from lfref.functional import fourier
from lfref.refocuser.refocuser import Refocuser


class Size(NamedTuple):
    """Size of a light field and of the stack made of it."""

    views: tuple[int, int]
    """Rows and columns of views (V, U)."""
    pixels: tuple[int, int]
    """Height and width (H, W) of a view."""
    planes: int

    def count(self, axis: str) -> int:
        """How many there are along an axis, a field of this class."""
        extent = getattr(self, axis)
        return extent if isinstance(extent, int) else math.prod(extent)


@dataclass(frozen=True)
class Scales:
    """The sizes along each axis."""

    sides: Sequence[float]
    """Sides of a view as a share of the field's own."""
    views: Sequence[int]
    """Rows, and columns, of views."""
    planes: Sequence[int]
    """Numbers of planes."""

    def __post_init__(self) -> None:
        for name, steps in vars(self).items():
            if len(set(steps)) < 2 or min(steps) <= 0:
                raise InputError(f"{name} must be at least two sizes above 0", got=list(steps))

    def sizes(self, field: Size) -> dict[str, list[Size]]:
        """The sizes of each axis, the other two axes being those of the field.

        Sides of views are rounded to lengths whose only prime factors are 2, 3 and 5, as 375 and 540 are: an FFT of
        another length takes longer for a reason that is not the size.
        """
        height, width = field.pixels
        own = field._replace(pixels=(_smooth(height), _smooth(width)))
        return {
            "pixels": [own._replace(pixels=(_smooth(height * side), _smooth(width * side))) for side in self.sides],
            "views": [own._replace(views=(n, n)) for n in self.views],
            "planes": [own._replace(planes=n) for n in self.planes],
        }


@torch.no_grad()
def times(
    methods: Iterable[Refocuser],
    sizes: dict[str, list[Size]],
    views: Callable[[Size], Tensor],
    rounds: int,
    warmup: int = 0,
) -> pd.DataFrame:
    """Time methods on all sizes; all sizes of one method take turns.

    Args:
        methods: What to time.
        sizes: As from `Scales.sizes`.
        views: Makes views of a size, where the methods run.
        rounds: Counted runs of each method at each size.
        warmup: Runs before them that do not count.

    Returns:
        Columns `method, axis, n, median_s, min_s`.
    """
    fields = {size: views(size) for size in dict.fromkeys(size for steps in sizes.values() for size in steps)}
    rows = []
    for method in methods:
        watches = {size: _watch(method, field, fractional_slopes(size.planes)) for size, field in fields.items()}
        seconds = timing.in_turns(watches, range(warmup + rounds), warmup)
        for axis, steps in sizes.items():
            for size in steps:
                rows.append((method.name, axis, size.count(axis), float(np.median(seconds[size])), min(seconds[size])))
    return pd.DataFrame(rows, columns=["method", "axis", "n", "median_s", "min_s"])


def exponents(times: pd.DataFrame) -> pd.DataFrame:
    """Least squares of log t on log n, for every method and axis.

    Args:
        times: As from `times`.

    Returns:
        Columns `method, axis, exponent`.
    """
    groups = times.groupby(["method", "axis"], sort=False)
    rows = [(*key, np.polyfit(np.log(group["n"]), np.log(group["min_s"]), 1)[0]) for key, group in groups]
    return pd.DataFrame(rows, columns=["method", "axis", "exponent"])


def fractional_slopes(n_planes: int) -> Tensor:
    """Slopes evenly spaced over (-1, 1), without its whole ends, which cost less because they need no interpolation.

    Args:
        n_planes: How many.
    """
    return geometry.even_slopes(n_planes, 1 / n_planes - 1, 1 - 1 / n_planes)


def random_views(size: Size, channels: int, device: torch.device) -> Tensor:
    """Random radiance, float32, [V, U, C, H, W].

    Args:
        size: Rows and columns of views and pixels.
        channels: C.
        device: Where it lies.
    """
    return torch.rand(*size.views, channels, *size.pixels, device=device)


def _watch(method: Refocuser, views: Tensor, slopes: Tensor) -> Callable[[], float]:
    return functools.partial(timing.seconds, functools.partial(method, views, slopes), views.device)


def _smooth(length: float) -> int:
    """The nearest whole number whose only prime factors are 2, 3 and 5."""
    candidates = range(1, 2 * math.ceil(length) + 1)
    return min(filter(fourier.is_fast, candidates), key=lambda n: abs(n - length))
