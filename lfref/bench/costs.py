"""Time of one call of every method, beside NumPy's 4-D FFT, and how it grows with the size of a light field.

Growth is the exponent p of `t ~ n^p` along one axis at a time: pixels of a view, views, planes.
Letters: `N` planes, `V U` view rows and columns, `C H W` channel, pixel row and column.
"""

import functools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from lfref import geometry
from lfref.bench import timing
from lfref.bench.timing import FFT
from lfref.functional.fourier import is_fast
from lfref.lightfield import LightField
from lfref.refocuser.refocuser import Refocuser


@torch.no_grad()
def times(
    methods: Sequence[Refocuser], fields: Sequence[LightField], slopes: Tensor, rounds: Iterable[int], warmup: int = 0
) -> pd.DataFrame:
    """Time all methods and NumPy's 4-D FFT in turns, on every light field; the first rounds, `warmup`, do not count."""
    # A method occurs once per light field: the place of the field is part of the key.
    watches: dict[tuple[str, int], Callable[[], float]] = {
        (FFT, place): functools.partial(timing.numpy_fft_time, field.views) for place, field in enumerate(fields)
    }
    for place, field in enumerate(fields):
        for method in methods:
            run = functools.partial(method, field, slopes)
            watches[method.name, place] = functools.partial(timing.seconds, run, field.views.device)
    seconds = timing.in_turns(watches, rounds, warmup)
    runs = pd.DataFrame([(name, s) for (name, _), counted in seconds.items() for s in counted], columns=["method", "s"])
    spans = runs.groupby("method", sort=False)["s"].quantile([0.5, 0.1, 0.9]).unstack()
    table = spans.set_axis(["median_s", "p10_s", "p90_s"], axis=1)
    table["numpy_ffts"] = table["median_s"] / table["median_s"].iloc[0]
    return table.reset_index()


class Size(NamedTuple):
    """Size of a light field and of its stack."""

    views: tuple[int, int]
    pixels: tuple[int, int]
    planes: int

    def count(self, axis: str) -> int:
        """Number of items along an axis, a field of this class."""
        extent = getattr(self, axis)
        return extent if isinstance(extent, int) else math.prod(extent)


@dataclass(frozen=True)
class Scales:
    """The sizes along each axis at which growth is measured."""

    sides: Sequence[float]
    """Sides of a view as a share of the field's own."""
    views: Sequence[int]
    """Numbers of view rows, and as many columns."""
    planes: Sequence[int]

    def sizes(self, field: Size) -> dict[str, list[Size]]:
        """Axis -> its sizes, with the field's own along the others; sides are lengths at which FFTs are fast."""
        height, width = field.pixels
        own = field._replace(pixels=(_fast_length(height), _fast_length(width)))
        sides = [(_fast_length(height * side), _fast_length(width * side)) for side in self.sides]
        return {
            "pixels": [own._replace(pixels=pixels) for pixels in sides],
            "views": [own._replace(views=(n, n)) for n in self.views],
            "planes": [own._replace(planes=n) for n in self.planes],
        }


def _fast_length(length: float) -> int:
    """The nearest length whose only prime factors are 2, 3 and 5."""
    return min(filter(is_fast, range(1, 2 * math.ceil(length) + 1)), key=lambda n: abs(n - length))


@torch.no_grad()
def growth_times(
    methods: Iterable[Refocuser],
    sizes: Mapping[str, Sequence[Size]],
    channels: int,
    device: torch.device,
    rounds: int,
    warmup: int = 0,
) -> pd.DataFrame:
    """Time methods on random views of all sizes (axis -> sizes); all sizes of one method take turns."""
    distinct = dict.fromkeys(size for steps in sizes.values() for size in steps)
    fields = {size: torch.rand(*size.views, channels, *size.pixels, device=device) for size in distinct}
    rows = []
    for method in methods:
        watches = {}
        for size, views in fields.items():
            # Slopes evenly inside (-1, 1): whole slopes need no interpolation and would cost less.
            slopes = geometry.even_slopes(size.planes, 1 / size.planes - 1, 1 - 1 / size.planes)
            run = functools.partial(method, views, slopes)
            watches[size] = functools.partial(timing.seconds, run, device)
        seconds = timing.in_turns(watches, range(warmup + rounds), warmup)
        for axis, steps in sizes.items():
            for size in steps:
                rows.append((method.name, axis, size.count(axis), float(np.median(seconds[size])), min(seconds[size])))
    return pd.DataFrame(rows, columns=["method", "axis", "n", "median_s", "min_s"])


def growth_exponents(times: pd.DataFrame) -> pd.DataFrame:
    """Least squares of log t on log n, by the fastest runs, since other work on a machine only adds time."""
    groups = times.groupby(["method", "axis"], sort=False)
    rows = [(*key, np.polyfit(np.log(group["n"]), np.log(group["min_s"]), 1)[0]) for key, group in groups]
    return pd.DataFrame(rows, columns=["method", "axis", "exponent"])
