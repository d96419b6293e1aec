"""Accuracy against time: every method on the same light fields, planes and device, in one run."""

import functools
import statistics
from collections.abc import Callable, Iterable, Sequence

import torch
from torch import Tensor

from lfref.bench import accuracy, timing
from lfref.bench.accuracy import Row
from lfref.bench.methods import Method
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus.exact_fourier import exact_fourier

Progress = Callable[[Iterable[Method]], Iterable[Method]]
"""Passes methods on, showing how far it is."""


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
        repeats: Counted runs a light field.
        warmup: Runs before them that do not count.
        progress: Passes methods on, showing how far it is.

    Returns:
        Rows `method, median_s, p10_s, p90_s, psnr_db, ssim, ratio_to_numpy_fft`, the first one NumPy's FFT alone.
        Times are for one light field and all planes; PSNR and SSIM are means over fields and planes, taken where
        every view covers every plane.
    """
    fft_times = [time for field in fields for time in timing.numpy_fft_times(field.views, max(2, repeats // 2))]
    baseline = timing.summary(fft_times)
    views = [field.views.to(device) for field in fields]
    references = [exact_fourier(field, planes.slopes).cpu() for field in views]
    rows = [_row("numpy_fft_4d", baseline, None, None, 1.0)]
    for method in progress(methods):
        seconds, psnr_db, ssim = _measured(method, views, references, planes.slopes, (repeats, warmup))
        rows.append(_row(method.name, seconds, psnr_db, ssim, baseline.median / seconds.median))
    return rows


def _measured(
    method: Method, fields: list[Tensor], references: list[Tensor], slopes: Tensor, runs: tuple[int, int]
) -> tuple[timing.Seconds, float, float]:
    times, qualities = [], []
    for views, reference in zip(fields, references, strict=True):
        run = functools.partial(method.refocus, views, slopes)
        times += timing.measure(run, *runs, views.device)
        grid = (views.shape[0], views.shape[1])
        qualities.append(accuracy.interior_quality(run().cpu(), reference, slopes, grid))
    psnr_db, ssim = (statistics.fmean(values) for values in zip(*qualities, strict=True))
    return timing.summary(times), psnr_db, ssim


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
