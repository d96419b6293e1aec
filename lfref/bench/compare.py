"""Accuracy against time: every method on the same light fields, planes and device, in one run."""

import functools
import statistics
from collections.abc import Callable, Iterator, Sequence

import torch

from lfref.bench import accuracy, timing
from lfref.bench.accuracy import Row
from lfref.bench.timing import FFT, Progress
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocuser.operators import OperatorRefocuser
from lfref.refocuser.refocuser import Refocuser


@torch.no_grad()
def compare(
    methods: Sequence[Refocuser],
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
    exact = OperatorRefocuser("exact_fourier", exact_fourier)
    references = [exact(field, planes.slopes).cpu() for field in moved]
    qualities = {
        method.name: [
            accuracy.interior_quality(method(field, planes.slopes).cpu(), reference, planes.slopes, field.grid)
            for field, reference in zip(moved, references, strict=True)
        ]
        for method in methods
    }
    watches = {(name, i): watch for i, field in enumerate(moved) for name, watch in _watches(methods, field, planes)}
    seconds: dict[str, list[float]] = {}
    for (name, _), times in timing.in_turns(watches, progress(range(warmup + repeats)), warmup).items():
        seconds.setdefault(name, []).extend(times)
    spans = {name: timing.summary(times) for name, times in seconds.items()}
    rows = [_row(FFT, spans[FFT], None, None, 1.0)]
    for name, values in qualities.items():
        psnr_db, ssim = (statistics.fmean(column) for column in zip(*values, strict=True))
        rows.append(_row(name, spans[name], psnr_db, ssim, spans[FFT].median / spans[name].median))
    return rows


def _watches(
    methods: Sequence[Refocuser], field: LightField, planes: FocalPlanes
) -> Iterator[tuple[str, Callable[[], float]]]:
    yield FFT, functools.partial(timing.numpy_fft_time, field.views)
    for method in methods:
        run = functools.partial(method, field, planes.slopes)
        yield method.name, functools.partial(timing.seconds, run, field.views.device)


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
