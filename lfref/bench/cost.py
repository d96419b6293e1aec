"""What one call of every method costs: time beside NumPy's 4-D FFT in the same run, memory, and the error it leaves.

Each measurement gives some columns for every method and type of input; `table` joins them. Errors are measured from
exact Fourier refocusing of the same views.
"""

import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from lfref.bench import accuracy, memory, timing
from lfref.bench.accuracy import Row
from lfref.bench.memory import Workload
from lfref.bench.timing import FFT
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocuser.operators import OperatorRefocuser
from lfref.refocuser.refocuser import Refocuser

Columns = dict[tuple[str, str], Row]
"""What was measured, by name of the method and type of its input."""

TABLE = (
    "method", "input", "device", "n_views", "height", "width", "channels", "planes", "first_call_s", "median_s",
    "p10_s", "p90_s", "ratio_to_numpy_fft", "ratio_to_same_in_numpy", "psnr_db", "max_error", "extra_bytes",
    "memory_ratio",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Case:
    """A method and the views it is measured on."""

    method: Refocuser
    views: Tensor
    """Radiance in float32, or uint8, on the device where the method runs, [V, U, C, H, W]."""
    has_planes_asked_for: bool = True
    """Otherwise it makes others, and exact refocusing to those asked for is no judge of them."""

    @property
    def key(self) -> tuple[str, str]:
        """What it is called in all measurements."""
        return self.method.name, str(self.views.dtype).removeprefix("torch.")

    def run(self, slopes: Tensor) -> Tensor:
        """Make the call."""
        return self.method(self.views, slopes)

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
def first_calls(cases: Iterable[Case], slopes: Tensor) -> Columns:
    """Time the first call of every method, which compiles, plans and fills caches, and judge what it makes.

    Args:
        cases: What to measure, not called before.
        slopes: In pixels per view step, [N].

    Returns:
        Columns `first_call_s, psnr_db, max_error`; the last two where every view covers every plane, PSNR as the mean
        over the planes. A stack on another grid than the views', or of other planes, is not judged.
    """
    exact: dict[str, Tensor] = {}
    columns: Columns = {}
    for case in cases:
        stack, seconds = timing.result_and_seconds(functools.partial(case.run, slopes), case.views.device)
        columns[case.key] = {"first_call_s": seconds}
        kind, grid = case.key[1], (case.views.shape[0], case.views.shape[1])
        exact[kind] = exact_fourier(case.views, slopes).cpu() if kind not in exact else exact[kind]
        if case.has_planes_asked_for and stack.shape == exact[kind].shape:
            psnr_db, largest = accuracy.interior_errors(stack.cpu(), exact[kind], slopes, grid)
            columns[case.key] |= {"psnr_db": psnr_db, "max_error": largest}
    return columns


@torch.no_grad()
def times(
    cases: Iterable[Case],
    slopes: Tensor,
    rounds: Iterable[int],
    warmup: int = 0,
    in_numpy: Mapping[str, str] | None = None,
) -> Columns:
    """Time all methods and NumPy's 4-D FFT in turns.

    Args:
        cases: What to measure, the first one in floating point: its views are those of the FFT.
        slopes: In pixels per view step, [N].
        rounds: One item a round.
        warmup: How many of the first rounds do not count.
        in_numpy: Names of methods -> names of the same methods written with NumPy alone.

    Returns:
        Columns `median_s, p10_s, p90_s, ratio_to_numpy_fft, ratio_to_same_in_numpy`, the FFT's first. Ratios are of
        medians, above 1 where the method is the faster one.
    """
    first, *_ = cases = list(cases)
    fft = (FFT, first.key[1])
    watches = {fft: functools.partial(timing.numpy_fft_time, first.views)}
    for case in cases:
        run = functools.partial(case.run, slopes)
        watches[case.key] = functools.partial(timing.seconds, run, case.views.device)
    spans = {key: timing.summary(counted) for key, counted in timing.in_turns(watches, rounds, warmup).items()}
    columns: Columns = {}
    for (name, kind), span in spans.items():
        twin = spans.get(((in_numpy or {}).get(name, ""), kind))
        columns[name, kind] = {
            "median_s": span.median,
            "p10_s": span.p10,
            "p90_s": span.p90,
            "ratio_to_numpy_fft": spans[fft].median / span.median,
            "ratio_to_same_in_numpy": None if twin is None else twin.median / span.median,
        }
    return columns


def peaks(cases: Iterable[Case], slopes: Tensor) -> Columns:
    """Peak memory of one call of every method.

    Args:
        cases: What to measure.
        slopes: In pixels per view step, [N].

    Returns:
        Columns `extra_bytes, memory_ratio`; see `lfref.bench.memory`.
    """
    columns: Columns = {}
    for case in cases:
        workload = case.workload(slopes)
        peak = memory.peak(workload, case.views.device)
        columns[case.key] = (
            {} if peak is None else {"extra_bytes": peak.extra_bytes, "memory_ratio": peak.ratio(workload)}
        )
    return columns


def table(cases: Iterable[Case], n_planes: int, *measured: Columns) -> list[Row]:
    """Join measurements to a row for every case, and one for NumPy's 4-D FFT before them.

    Args:
        cases: What was measured.
        n_planes: Planes of the stacks.
        *measured: As from the functions above.

    Returns:
        Rows with the columns of `TABLE`, None where one does not apply.
    """
    first, *_ = cases = list(cases)
    fft = Case(OperatorRefocuser(FFT, exact_fourier), first.views.cpu())
    rows = [_facts(fft, None), *(_facts(case, n_planes) for case in cases)]
    for row, case in zip(rows, (fft, *cases), strict=True):
        for columns in measured:
            row |= columns.get(case.key, {})
    return [{column: row.get(column) for column in TABLE} for row in rows]


def _facts(case: Case, n_planes: int | None) -> Row:
    n_rows, n_columns, channels, height, width = case.views.shape
    name, kind = case.key
    return {
        "method": name,
        "input": kind,
        "device": case.views.device.type,
        "n_views": n_rows * n_columns,
        "height": height,
        "width": width,
        "channels": channels,
        "planes": n_planes,
    }
