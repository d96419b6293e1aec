"""Reliable times, after a warm-up, in turns, synchronised with the device; and the facts of the machine.

The unit of comparison is the paper's: NumPy's 4-D FFT of the three colour channels, which Fourier-slice refocusing
needs before its first plane.
"""

import ast
import hashlib
import json
import os
import platform
import re
import time
from collections.abc import Callable, Iterable, Mapping
from importlib import metadata
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from lfref.io import atomic

Key = TypeVar("Key")

FFT = "numpy_fft_4d"
MEASURED = "functional", "refocus", "refocuser", "simulator", "nets", "metrics", "losses", "bench"
"""Folders whose code decides about figures."""
PACKAGES = ("lfref", "torch", "numpy", "lightning", "torchmetrics", "OpenImageIO", "numba")


def seconds(run: Callable[[], object], device: torch.device) -> float:
    """Time of one run, from an idle device to an idle device."""
    _synchronize(device)
    start = time.perf_counter()
    run()
    _synchronize(device)
    return time.perf_counter() - start


def _synchronize(device: torch.device) -> None:
    # Calls on a GPU return before their work is done.
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def in_turns(
    watches: Mapping[Key, Callable[[], float]], rounds: Iterable[int], warmup: int = 0
) -> dict[Key, list[float]]:
    """Seconds that watches return, in rounds in which all take turns: a slow spell of the machine falls on all."""
    times: dict[Key, list[float]] = {key: [] for key in watches}
    for _ in rounds:
        for key, watch in watches.items():
            times[key].append(watch())
    return {key: counted[warmup:] for key, counted in times.items()}


def numpy_fft_time(views: Tensor) -> float:
    """Seconds of NumPy's 4-D FFT of views [V, U, C, H, W], one channel after the other as the paper does."""
    channels = [np.ascontiguousarray(channel) for channel in views.cpu().numpy().transpose(2, 0, 1, 3, 4)]
    return seconds(lambda: [np.fft.fftn(channel) for channel in channels], torch.device("cpu"))


def write_facts(folder: Path, device: torch.device, **more: object) -> None:
    """Write `facts` and more for the readers of a table as `machine.json`."""
    atomic.write_text(folder / "machine.json", json.dumps(facts(device) | more, indent=2) + "\n")


def code_hash() -> str:
    """Short hash of the modules that decide about figures, without comments and docstrings."""
    package, digest = Path(__file__).parents[1], hashlib.sha256()
    for path in sorted(path for folder in MEASURED for path in package.joinpath(folder).rglob("*.py")):
        tree = ast.parse(path.read_text("utf-8"))
        for node in ast.walk(tree):
            body = getattr(node, "body", None)
            if isinstance(body, list):
                node.body = [line for line in body if not isinstance(getattr(line, "value", None), ast.Constant)]  # type: ignore[attr-defined]
        digest.update(ast.dump(tree).encode())
    return digest.hexdigest()[:8]


def facts(device: torch.device) -> dict[str, str | int]:
    """Machine, libraries, thread count and code."""
    return {
        "code": code_hash(),
        "processor": processor(),
        "cores": os.cpu_count() or 1,
        "threads": torch.get_num_threads(),
        "device": torch.cuda.get_device_name(device) if device.type == "cuda" else device.type.upper(),
        "system": platform.platform(),
        "python": platform.python_version(),
        **{package: metadata.version(package) for package in PACKAGES},
    }


def processor() -> str:
    """Name of the processor and its widest vector instructions."""
    listing = Path("/proc/cpuinfo")
    name = re.search(r"model name\s*: (.*)", listing.read_text() if listing.is_file() else "")
    return f"{name[1] if name else platform.processor()} ({torch.backends.cpu.get_cpu_capability()})"
