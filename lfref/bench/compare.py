"""Accuracy against time: every method on the same light fields, planes and device, in one run."""

import functools
import statistics
from collections.abc import Callable, Iterable, Sequence

import torch
from torch import Tensor

from lfref.bench import accuracy, timing
from lfref.bench.accuracy import Row
from lfref.bench.methods import Method
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus.exact_fourier import exact_fourier

Progress = Callable[[Iterable[int]], Iterable[int]]
"""Passes rounds on, showing how far it is."""

FFT = "numpy_fft_4d"


@torch.no_grad()
def compare(
    methods: Sequence[Method],
    fields: Sequence[LightField],
    planes: FocalPlanes,
    device: torch.device,
    repeats: int = 5,
    warmup: int = 1,
    progress: Progress = iter,
) -> list[Row]:
    """Time every method and judge it by exact Fourier refocusing.

    Args:
        methods: What to compare.
        fields: Light fields that all methods refocus.
        planes: Planes that all methods make.
        device: Where all methods run; NumPy's 4-D FFT always runs on the CPU.
        repeats: Counted runs of each method on each light field.
        warmup: Runs before them that do not count.
        progress: Passes rounds on, showing how far it is.

    Returns:
        Rows `method, median_s, p10_s, p90_s, psnr_db, ssim, ratio_to_numpy_fft`, the first one NumPy's FFT alone.
        Times are for one light field and all planes; PSNR and SSIM are means over fields and planes, taken where
        every view covers every plane.

    Raises:
        InputError: Nothing to measure.
    """
    if not fields or not methods or repeats < 1 or warmup < 0:
        raise InputError(
            "a comparison needs methods, light fields and at least one counted run",
            got=f"{len(methods)} methods, {len(fields)} light fields, repeats={repeats}, warmup={warmup}",
        )
    if len({method.name for method in methods}) < len(methods):
        raise InputError("methods must have names of their own", got=[method.name for method in methods])
    moved = [field.to(device) for field in fields]
    exact = Method("exact_fourier", exact_fourier)
    references = [exact.stack(field, planes.slopes).cpu() for field in moved]
    qualities = {
        method.name: [
            accuracy.interior_quality(method.stack(field, planes.slopes).cpu(), reference, planes.slopes, field.grid)
            for field, reference in zip(moved, references, strict=True)
        ]
        for method in methods
    }
    seconds = _seconds(methods, moved, planes.slopes, progress(range(warmup + repeats)))
    spans = {name: timing.summary(times[warmup * len(fields) :]) for name, times in seconds.items()}
    rows = [_row(FFT, spans[FFT], None, None, 1.0)]
    for name, values in qualities.items():
        psnr_db, ssim = (statistics.fmean(column) for column in zip(*values, strict=True))
        rows.append(_row(name, spans[name], psnr_db, ssim, spans[FFT].median / spans[name].median))
    return rows


def _seconds(
    methods: Sequence[Method], fields: Sequence[LightField], slopes: Tensor, rounds: Iterable[int]
) -> dict[str, list[float]]:
    """Times by method. All methods take turns, so that a slow spell of a shared machine falls on all alike."""
    seconds: dict[str, list[float]] = {FFT: [], **{method.name: [] for method in methods}}
    for _ in rounds:
        for field in fields:
            seconds[FFT].append(timing.numpy_fft_time(field.views))
            for method in methods:
                run = functools.partial(method.stack, field, slopes)
                seconds[method.name].append(timing.seconds(run, field.views.device))
    return seconds


def _row(name: str, seconds: timing.Seconds, psnr_db: float | None, ssim: float | None, ratio: float) -> Row:
    return {
        "method": name,
        "median_s": seconds.median,
        "p10_s": seconds.p10,
        "p90_s": seconds.p90,
        "psnr_db": psnr_db,
        "ssim": ssim,
        "ratio_to_numpy_fft": ratio,
    }
