"""Costs of one call of every method: time beside NumPy's 4-D FFT, memory, error, and growth with size.

A method measured on several light fields has one row for all. Errors are distances from exact Fourier refocusing of the
same light field. Growth is the exponent p of `t ~ n^p` along one axis at a time: pixels of a view, views, planes.
Each group of `lfref bench` has a module of its own.
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
from lfref.bench import accuracy, memory, timing
from lfref.bench.accuracy import EXACT
from lfref.bench.memory import Workload
from lfref.bench.timing import FFT
from lfref.errors import InputError
from lfref.functional.fft_lengths import is_fast
from lfref.lightfield import LightField
from lfref.refocuser.refocuser import Refocuser

KEY = ["method", "input"]
"""Index of all tables: a row per method and type of input."""
COLUMNS = (
    "device", "n_views", "height", "width", "channels", "planes", "first_call_s", "median_s", "p10_s", "p90_s",
    "numpy_ffts", "ratio_to_same_in_numpy", "psnr_db", "max_error", "extra_bytes", "memory_ratio",
)  # fmt: skip
"""Columns of the table of operators after `KEY`."""


@dataclass(frozen=True, eq=False)
class MethodCase:
    """A method and the light field on which it is measured."""

    method: Refocuser
    light: LightField | Tensor
    """Light field on the device of the method; or only its views, float32 or uint8, [V, U, C, H, W]."""
    has_reference: bool = True
    """False: the method makes other planes, so exact refocusing is no reference for them."""

    @property
    def views(self) -> Tensor:
        """Views of the light field, [V, U, C, H, W]."""
        return self.light.views if isinstance(self.light, LightField) else self.light

    @property
    def key(self) -> tuple[str, str]:
        """Key of its row in all tables: method and type of the input."""
        return self.method.name, str(self.views.dtype).removeprefix("torch.")

    def run(self, slopes: Tensor) -> Tensor:
        """The stack at these slopes [N]."""
        return self.method(self.light, slopes)

    def workload(self, slopes: Tensor) -> Workload:
        """The call of `run` at these slopes [N], for another process."""
        shape, planes = tuple(self.views.shape), tuple(slopes.tolist())
        return Workload(self.method, shape, self.views.dtype, planes, torch.get_num_threads())


@torch.no_grad()
def first_calls(cases: Iterable[MethodCase], slopes: Tensor) -> pd.DataFrame:
    """Time of the first call, which compiles, plans and fills caches, and errors of its stack at these slopes [N].

    Returns:
        Columns `first_call_s, psnr_db, max_error`, means over the light fields, errors in the interior; no errors for a
        stack of other planes, or on another grid than the views'.
    """
    # Cases on one light field follow each other; the cache saves exact refocusing for each.
    exact = functools.lru_cache(maxsize=4)(lambda light: EXACT(light, slopes).cpu())
    rows = []
    for case in cases:
        stack, seconds = timing.result_and_seconds(functools.partial(case.run, slopes), case.views.device)
        row = {**dict(zip(KEY, case.key, strict=True)), "first_call_s": seconds}
        reference, grid = exact(case.light), (case.views.shape[0], case.views.shape[1])
        if case.has_reference and stack.shape == reference.shape:
            row |= accuracy.interior_errors(stack.cpu(), reference, slopes, grid)
        rows.append(row)
    columns = [*KEY, "first_call_s", "psnr_db", "max_error"]
    return pd.DataFrame(rows, columns=columns).groupby(KEY, sort=False).mean()


@torch.no_grad()
def times(
    cases: Sequence[MethodCase],
    slopes: Tensor,
    rounds: Iterable[int],
    warmup: int = 0,
    in_numpy: Mapping[str, str] | None = None,
) -> pd.DataFrame:
    """Time all methods and NumPy's 4-D FFT in turns.

    Args:
        cases: Methods with light fields, the first in floating point; the FFT is computed for all views of the first
            method.
        slopes: Slopes in pixels per view step, [N].
        rounds: One item per round.
        warmup: Number of first rounds that do not count.
        in_numpy: Method -> name of the same method written with NumPy alone.

    Returns:
        Columns `median_s, p10_s, p90_s, numpy_ffts, ratio_to_same_in_numpy`, the FFT's row first. Ratios are
        those of medians, above 1 if the method is faster.

    Raises:
        InputError: There is nothing to measure.
    """
    if not cases:
        raise InputError("there must be something to measure", got="no method or no light field")
    # A method occurs once per light field: its place among the cases is part of the key.
    watches: dict[tuple[str, str, int], Callable[[], float]] = {
        (FFT, case.key[1], place): functools.partial(timing.numpy_fft_time, case.views)
        for place, case in enumerate(cases)
        if case.key == cases[0].key
    }
    for place, case in enumerate(cases):
        run = functools.partial(case.run, slopes)
        watches[*case.key, place] = functools.partial(timing.seconds, run, case.views.device)
    seconds = timing.in_turns(watches, rounds, warmup)
    runs = pd.DataFrame([(*key[:2], s) for key, counted in seconds.items() for s in counted], columns=[*KEY, "s"])
    spans = runs.groupby(KEY, sort=False)["s"].quantile([0.5, 0.1, 0.9]).unstack()
    table = spans.set_axis(["median_s", "p10_s", "p90_s"], axis=1)
    medians, twins = table["median_s"], in_numpy or {}
    table["numpy_ffts"] = medians / medians.iloc[0]
    table["ratio_to_same_in_numpy"] = [
        medians.get((twins.get(name, ""), kind), math.nan) / median for (name, kind), median in medians.items()
    ]
    return table


def peaks(cases: Iterable[MethodCase], slopes: Tensor) -> pd.DataFrame:
    """Peak memory of one call of every method at these slopes [N].

    Returns:
        Columns `extra_bytes, memory_ratio`, empty where memory cannot be measured; see `lfref.bench.memory`.
    """
    rows = []
    for case in cases:
        workload = case.workload(slopes)
        peak = memory.peak(workload, case.views.device)
        rows.append((*case.key, *((None, None) if peak is None else (peak.extra_bytes, peak.ratio(workload)))))
    table = pd.DataFrame(rows, columns=[*KEY, "extra_bytes", "memory_ratio"]).set_index(KEY)
    return table.astype({"extra_bytes": "Int64"})


def operators_table(cases: Sequence[MethodCase], n_planes: int, *measurements: pd.DataFrame) -> pd.DataFrame:
    """Sizes and measurements (of the functions above) side by side: `KEY` and `COLUMNS`, the FFT's row first."""

    def row(case: MethodCase) -> tuple[str | int | None, ...]:
        n_rows, n_columns, channels, height, width = case.views.shape
        return (*case.key, case.views.device.type, n_rows * n_columns, height, width, channels, n_planes)

    _, kind, _, *size, _ = row(cases[0])
    rows = [(FFT, kind, "cpu", *size, None), *map(row, cases)]
    sizes = pd.DataFrame(rows, columns=[*KEY, *COLUMNS[:6]]).set_index(KEY).astype({"planes": "Int64"})
    return sizes.join([*measurements]).reindex(columns=[*COLUMNS]).reset_index()


class SpeedLimits(NamedTuple):
    """Least times of one linear shift-and-sum on this machine, in seconds (the two roofs of the roofline model)."""

    bytes_s: float
    """Time to read the field and write the stack once, at the rate of a copy in memory."""
    arithmetic_s: float
    """Time for its multiply-adds, at the rate of a large matrix product."""


LIMIT_ROUNDS = 5
"""Number of runs, of which the fastest counts."""
MATRIX_SIDE = 2048
"""Side of the matrices: large enough for the full rate, a fraction of a second on a CPU."""


@torch.no_grad()
def shift_and_sum_limits(views: Tensor, n_planes: int) -> SpeedLimits:
    """Measure the limits on the device of the views, float32, [V, U, C, H, W]."""

    def fastest(run: Callable[[], object]) -> float:
        return min(timing.seconds(run, views.device) for _ in range(LIMIT_ROUNDS))

    copy, matrix = torch.empty_like(views), torch.rand(MATRIX_SIDE, MATRIX_SIDE, device=views.device)
    product = torch.empty_like(matrix)
    copy_s = fastest(functools.partial(copy.copy_, views))
    product_s = fastest(functools.partial(torch.mm, matrix, matrix, out=product))
    stack_bytes = n_planes * views[0, 0].numel() * views.element_size()
    # A copy moves the field twice, in and out.
    bytes_share = (views.nbytes + stack_bytes) / (2 * views.nbytes)
    return SpeedLimits(copy_s * bytes_share, product_s * multiply_adds(views, n_planes) / MATRIX_SIDE**3)


def multiply_adds(views: Tensor, n_planes: int) -> int:
    """Multiply-adds of a linear shift-and-sum: two per sample along rows, two per row sum along columns."""
    n_rows, n_columns = views.shape[:2]
    return n_planes * views[0, 0].numel() * 2 * (n_rows * n_columns + n_rows)


class Size(NamedTuple):
    """Size of a light field and of its stack."""

    views: tuple[int, int]
    """Rows and columns of views (V, U)."""
    pixels: tuple[int, int]
    """Height and width (H, W) of a view."""
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
    """Numbers of planes."""

    def __post_init__(self) -> None:
        for name, steps in vars(self).items():
            if len(set(steps)) < 2 or min(steps) <= 0:
                raise InputError(f"{name} must be at least two sizes above 0", got=list(steps))

    def sizes(self, field: Size) -> dict[str, list[Size]]:
        """Axis -> its sizes, with the field's own sizes along the other two axes.

        Sides of views are rounded to lengths at which FFTs are fast, as 375 and 540 are: times depend on size only.
        """
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
    """Time methods on random views of all sizes (axis -> sizes); all sizes of one method take turns.

    Returns:
        Columns `method, axis, n, median_s, min_s`, of the runs after the warm-up.
    """
    distinct = dict.fromkeys(size for steps in sizes.values() for size in steps)
    fields = {size: torch.rand(*size.views, channels, *size.pixels, device=device) for size in distinct}
    rows = []
    for method in methods:
        watches = {}
        for size, views in fields.items():
            run = functools.partial(method, views, fractional_slopes(size.planes))
            watches[size] = functools.partial(timing.seconds, run, device)
        seconds = timing.in_turns(watches, range(warmup + rounds), warmup)
        for axis, steps in sizes.items():
            for size in steps:
                rows.append((method.name, axis, size.count(axis), float(np.median(seconds[size])), min(seconds[size])))
    return pd.DataFrame(rows, columns=["method", "axis", "n", "median_s", "min_s"])


def growth_exponents(times: pd.DataFrame) -> pd.DataFrame:
    """Least squares of log t on log n of `growth_times`: columns `method, axis, exponent`.

    The fastest runs are fitted, not the medians: other work on a machine only adds time.
    """
    groups = times.groupby(["method", "axis"], sort=False)
    rows = [(*key, np.polyfit(np.log(group["n"]), np.log(group["min_s"]), 1)[0]) for key, group in groups]
    return pd.DataFrame(rows, columns=["method", "axis", "exponent"])


def fractional_slopes(n_planes: int) -> Tensor:
    """Slopes evenly spaced inside (-1, 1): whole slopes need no interpolation and would cost less."""
    return geometry.even_slopes(n_planes, 1 / n_planes - 1, 1 - 1 / n_planes)
