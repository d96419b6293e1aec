"""Times that can be trusted: warmed up, synchronised with the device, and given as a spread.

The unit of comparison is the paper's: NumPy's 4-D FFT of the three colour channels, which Fourier-slice refocusing
needs before its first plane.
"""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor


@dataclass(frozen=True)
class Seconds:
    """Median and spread of repeated runs, in seconds."""

    median: float
    p10: float
    p90: float


def synchronize(device: torch.device) -> None:
    """Wait until a device has done what was asked of it."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def measure(run: Callable[[], object], repeats: int, warmup: int, device: torch.device) -> list[float]:
    """Time repeated runs.

    Args:
        run: What to time; its result is thrown away.
        repeats: Runs that count.
        warmup: Runs before them that do not.
        device: Where the work is done.

    Returns:
        Seconds of each counted run.
    """
    times = []
    for _ in range(warmup + repeats):
        synchronize(device)
        start = time.perf_counter()
        run()
        synchronize(device)
        times.append(time.perf_counter() - start)
    return times[warmup:]


def summary(times: list[float]) -> Seconds:
    """Median, 10th and 90th percentile of run times."""
    p10, p90 = np.percentile(times, [10, 90]).tolist()
    return Seconds(statistics.median(times), p10, p90)


def numpy_fft_times(views: Tensor, repeats: int, warmup: int = 1) -> list[float]:
    """Time NumPy's 4-D FFT, one channel after the other as the paper does.

    Args:
        views: Light field [V, U, C, H, W].
        repeats: Runs that count.
        warmup: Runs before them that do not.

    Returns:
        Seconds for all channels, one entry a run.
    """
    channels = [np.ascontiguousarray(channel) for channel in views.cpu().numpy().transpose(2, 0, 1, 3, 4)]
    return measure(lambda: [np.fft.fftn(channel) for channel in channels], repeats, warmup, torch.device("cpu"))
