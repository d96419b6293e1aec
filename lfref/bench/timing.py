"""Times that can be trusted: warmed up, taken in turns, and synchronised with the device.

The unit of comparison is the paper's: NumPy's 4-D FFT of the three colour channels, which Fourier-slice refocusing
needs before its first plane.
"""

import os
import platform
import time
from collections.abc import Callable, Iterable, Mapping
from importlib import metadata
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

Key = TypeVar("Key")
Result = TypeVar("Result")

FFT = "numpy_fft_4d"
"""What tables call NumPy's 4-D FFT."""


def synchronize(device: torch.device) -> None:
    """Wait until a device has done what was asked of it."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def seconds(run: Callable[[], object], device: torch.device) -> float:
    """Time one run, from an idle device to an idle device.

    Args:
        run: What to time; its result is thrown away.
        device: Where the work is done.
    """
    return result_and_seconds(run, device)[1]


def result_and_seconds(run: Callable[[], Result], device: torch.device) -> tuple[Result, float]:
    """What one run makes, and how long it takes, from an idle device to an idle device.

    Args:
        run: What to time.
        device: Where the work is done.
    """
    synchronize(device)
    start = time.perf_counter()
    result = run()
    synchronize(device)
    return result, time.perf_counter() - start


def in_turns(
    watches: Mapping[Key, Callable[[], float]], rounds: Iterable[int], warmup: int = 0
) -> dict[Key, list[float]]:
    """Times from several rounds in which all take turns, so that a slow spell of a shared machine falls on all alike.

    Args:
        watches: Each makes one run and returns its seconds.
        rounds: One item a round.
        warmup: How many of the first rounds do not count.

    Returns:
        Seconds of the counted runs, in their order, under the keys of the watches.
    """
    times: dict[Key, list[float]] = {key: [] for key in watches}
    for _ in rounds:
        for key, watch in watches.items():
            times[key].append(watch())
    return {key: counted[warmup:] for key, counted in times.items()}


def numpy_fft_time(views: Tensor) -> float:
    """Time NumPy's 4-D FFT, one channel after the other as the paper does.

    Args:
        views: Light field [V, U, C, H, W].

    Returns:
        Seconds for all channels.
    """
    channels = [np.ascontiguousarray(channel) for channel in views.cpu().numpy().transpose(2, 0, 1, 3, 4)]
    return seconds(lambda: [np.fft.fftn(channel) for channel in channels], torch.device("cpu"))


# PART machine
# What a measurement was made on, so that a table can be read a year later.

PACKAGES = ("torch", "numpy", "lightning", "torchmetrics", "OpenImageIO", "numba")


def facts(device: torch.device) -> dict[str, str | int | None]:
    """Machine, libraries and thread count.

    Args:
        device: Where the work is done.
    """
    return {
        "processor": processor(),
        "cores": os.cpu_count() or 1,
        "threads": torch.get_num_threads(),
        "device": torch.cuda.get_device_name(device) if device.type == "cuda" else device.type.upper(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "lfref": metadata.version("lfref"),
        **{package: version(package) for package in PACKAGES},
    }


def version(package: str) -> str | None:
    """Version of a package; None where it is not installed.

    Args:
        package: Its name.
    """
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def processor() -> str:
    """Name of the processor and its widest vector instructions."""
    listing = Path("/proc/cpuinfo")
    lines = listing.read_text().splitlines() if listing.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{names[0] if names else platform.processor()} ({torch.backends.cpu.get_cpu_capability()})"
