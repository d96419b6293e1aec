"""What one call of every method costs: time beside NumPy's 4-D FFT in the same run, memory, and the error it leaves.

Each measurement is a table with a row for every method and type of input, which are its index; a method that is
measured on several light fields has one row for all of them. Errors are measured from exact Fourier refocusing of the
same light field.
"""

import functools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import pandas as pd
import torch
from torch import Tensor

from lfref.bench import accuracy, memory, timing
from lfref.bench.memory import Workload
from lfref.bench.timing import FFT
from lfref.errors import InputError
from lfref.lightfield import LightField
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocuser.operators import OperatorRefocuser
from lfref.refocuser.refocuser import Refocuser

KEY = ["method", "input"]
EXACT = OperatorRefocuser("exact_fourier", exact_fourier)

OPERATORS = (
    "device", "n_views", "height", "width", "channels", "planes", "first_call_s", "median_s", "p10_s", "p90_s",
    "ratio_to_numpy_fft", "ratio_to_same_in_numpy", "psnr_db", "max_error", "extra_bytes", "memory_ratio",
)  # fmt: skip
"""Columns of what operators cost."""


@dataclass(frozen=True, eq=False)
class Case:
    """A method and the light field it is measured on."""

    method: Refocuser
    light: LightField | Tensor
    """On the device where the method runs; or its views alone, float32 or uint8, [V, U, C, H, W]."""
    has_planes_asked_for: bool = True
    """Otherwise it makes others, and exact refocusing to those asked for is no judge of them."""

    @property
    def views(self) -> Tensor:
        """The views, [V, U, C, H, W]."""
        return self.light.views if isinstance(self.light, LightField) else self.light

    @property
    def key(self) -> tuple[str, str]:
        """What it is called in all measurements."""
        return self.method.name, str(self.views.dtype).removeprefix("torch.")

    def run(self, slopes: Tensor) -> Tensor:
        """Make the call."""
        return self.method(self.light, slopes)

    def workload(self, slopes: Tensor) -> Workload:
        """The call, described for another process."""
        shape, planes = tuple(self.views.shape), tuple(slopes.tolist())
        return Workload(self.method, shape, self.views.dtype, planes, torch.get_num_threads())


def as_integers(views: Tensor) -> Tensor:
    """Views as an 8-bit file holds them.

    Args:
        views: Radiance in [0, 1], any shape.
    """
    return (views * 255).round().clamp(0, 255).to(torch.uint8)


@torch.no_grad()
def first_calls(cases: Iterable[Case], slopes: Tensor, measures: Sequence[str]) -> pd.DataFrame:
    """Time the first call of every method, which compiles, plans and fills caches, and judge what it makes.

    Args:
        cases: What to measure, not called before; those on the same light field and type of input share it.
        slopes: In pixels per view step, [N].
        measures: What it is judged by, keys of `accuracy.MEASURES`.

    Returns:
        Columns `first_call_s` and the measures, where every view covers every plane, means over the light fields.
        A stack on another grid than the views', or of other planes, is not judged.
    """
    exact = functools.lru_cache(maxsize=4)(lambda light: EXACT(light, slopes).cpu())
    rows = []
    for case in cases:
        stack, seconds = timing.result_and_seconds(functools.partial(case.run, slopes), case.views.device)
        row = {**dict(zip(KEY, case.key, strict=True)), "first_call_s": seconds}
        reference, grid = exact(case.light), (case.views.shape[0], case.views.shape[1])
        if case.has_planes_asked_for and stack.shape == reference.shape:
            row |= accuracy.interior_quality(stack.cpu(), reference, slopes, grid, measures)
        rows.append(row)
    return pd.DataFrame(rows, columns=[*KEY, "first_call_s", *measures]).groupby(KEY, sort=False).mean()


@torch.no_grad()
def times(
    cases: Sequence[Case],
    slopes: Tensor,
    rounds: Iterable[int],
    warmup: int = 0,
    in_numpy: Mapping[str, str] | None = None,
) -> pd.DataFrame:
    """Time all methods and NumPy's 4-D FFT in turns.

    Args:
        cases: What to measure, the first one in floating point: the FFT is taken of all views that its method is
            measured on.
        slopes: In pixels per view step, [N].
        rounds: One item a round.
        warmup: How many of the first rounds do not count.
        in_numpy: Names of methods -> names of the same methods written with NumPy alone.

    Returns:
        Columns `median_s, p10_s, p90_s, ratio_to_numpy_fft, ratio_to_same_in_numpy`, the FFT's first. Ratios are of
        medians, above 1 where the method is the faster one.

    Raises:
        InputError: Nothing to measure.
    """
    if not cases:
        raise InputError("there must be something to measure", got="no method or no light field")
    transformed = [case for case in cases if case.key == cases[0].key]
    watches: list[tuple[tuple[str, str], Callable[[], float]]] = [
        ((FFT, case.key[1]), functools.partial(timing.numpy_fft_time, case.views)) for case in transformed
    ]
    for case in cases:
        run = functools.partial(case.run, slopes)
        watches.append((case.key, functools.partial(timing.seconds, run, case.views.device)))
    spent = timing.in_turns(dict(enumerate(watch for _, watch in watches)), rounds, warmup)
    seconds = pd.DataFrame([(*key, each) for place, (key, _) in enumerate(watches) for each in spent[place]])
    spans = seconds.set_axis([*KEY, "s"], axis=1).groupby(KEY, sort=False)["s"].quantile([0.5, 0.1, 0.9]).unstack()
    table = spans.set_axis(["median_s", "p10_s", "p90_s"], axis=1)
    medians, twins = table["median_s"], in_numpy or {}
    table["ratio_to_numpy_fft"] = medians.iloc[0] / medians
    table["ratio_to_same_in_numpy"] = [
        medians.get((twins.get(name, ""), kind), math.nan) / median for (name, kind), median in medians.items()
    ]
    return table


def peaks(cases: Iterable[Case], slopes: Tensor) -> pd.DataFrame:
    """Peak memory of one call of every method.

    Args:
        cases: What to measure.
        slopes: In pixels per view step, [N].

    Returns:
        Columns `extra_bytes, memory_ratio`, empty where it cannot be measured; see `lfref.bench.memory`.
    """
    rows = []
    for case in cases:
        workload = case.workload(slopes)
        peak = memory.peak(workload, case.views.device)
        rows.append((*case.key, *((None, None) if peak is None else (peak.extra_bytes, peak.ratio(workload)))))
    table = pd.DataFrame(rows, columns=[*KEY, "extra_bytes", "memory_ratio"]).set_index(KEY)
    return table.astype({"extra_bytes": "Int64"})


def facts(cases: Iterable[Case], n_planes: int) -> pd.DataFrame:
    """What every method was measured on.

    Args:
        cases: What was measured, the first one on the views of which the FFT was taken.
        n_planes: Planes of the stacks.

    Returns:
        Columns `device, n_views, height, width, channels, planes`, the FFT's first, which makes no planes.
    """
    first, *_ = cases = list(cases)
    fft, rows = Case(OperatorRefocuser(FFT, exact_fourier), first.views.cpu()), []
    for case in (fft, *cases):
        n_rows, n_columns, channels, height, width = case.views.shape
        planes = None if case is fft else n_planes
        rows.append((*case.key, case.views.device.type, n_rows * n_columns, height, width, channels, planes))
    return pd.DataFrame(rows, columns=[*KEY, *OPERATORS[:6]]).set_index(KEY).astype({"planes": "Int64"})


def table(columns: Sequence[str], first: pd.DataFrame, *others: pd.DataFrame) -> pd.DataFrame:
    """Measurements beside each other.

    Args:
        columns: Which to keep after `method` and `input`, in this order.
        first: As from the functions above; it has all the rows.
        *others: Likewise.
    """
    return first.join([*others]).reindex(columns=[*columns]).reset_index()


# PART limits
# The machine's own limits for shift-and-sum: how fast it moves the bytes, and how fast it multiplies and adds.
#
# No program that reads the field and writes the stack can be faster than the first; none of this arithmetic can be
# faster than the second, the rate of a large matrix product, the best use of the arithmetic units there is.

ROUNDS = 5
SIDE = 2048  # of the matrices: large enough for the full rate, a fraction of a second on a CPU


class Limits(NamedTuple):
    """Least times of one linear shift-and-sum, in seconds."""

    bytes_s: float
    """To read the field and write the stack once, as fast as a copy in memory."""
    arithmetic_s: float
    """For its multiply-adds, as fast as in a matrix product."""


@torch.no_grad()
def shift_and_sum_limits(views: Tensor, n_planes: int) -> Limits:
    """Measure the limits where the views are.

    Args:
        views: Light field in float32, [V, U, C, H, W].
        n_planes: Planes of the stack.
    """
    copied, matrix = torch.empty_like(views), torch.rand(SIDE, SIDE, device=views.device)
    product = torch.empty_like(matrix)
    copying = _fastest(functools.partial(copied.copy_, views), views.device)
    multiplying = _fastest(functools.partial(torch.mm, matrix, matrix, out=product), views.device)
    stack_bytes = n_planes * views[0, 0].numel() * views.element_size()
    share_of_copy = (views.nbytes + stack_bytes) / (2 * views.nbytes)
    return Limits(copying * share_of_copy, multiplying * multiply_adds(views, n_planes) / SIDE**3)


def multiply_adds(views: Tensor, n_planes: int) -> int:
    """Multiply-adds of a linear shift-and-sum: two for each sample across every view row, two for each row's sum.

    Args:
        views: Light field, [V, U, C, H, W].
        n_planes: Planes of the stack.
    """
    n_rows, n_columns = views.shape[:2]
    return n_planes * views[0, 0].numel() * 2 * (n_rows * n_columns + n_rows)


def _fastest(run: functools.partial[Tensor], device: torch.device) -> float:
    return min(timing.seconds(run, device) for _ in range(ROUNDS))
