"""Peak memory of one call, beyond the views and including the stack.

PyTorch counts allocations on a GPU but not on the CPU. There the peak resident memory of a fresh process is read,
before and after the call, with the views in memory and the operator warmed up on a field of a few pixels, so that
libraries and compilation do not count. The process makes random views of its own, so that it needs only a description.
"""

import functools
import math
import multiprocessing
import re
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, TypeVar

import torch
from torch import Tensor

from lfref import geometry
from lfref.functional import memory

Result = TypeVar("Result")

PROCESS = Path("/proc/self")
"""Folder with the facts of this process, on Linux."""


@dataclass(frozen=True)
class Workload:
    """A call that another process can make."""

    operator: Callable[[Tensor, Tensor], Tensor]
    """(views, slopes) -> stack; a function of a module, or a partial of one."""
    shape: tuple[int, ...]
    """Shape of the views, (V, U, C, H, W)."""
    dtype: torch.dtype
    """Type of the views, float32 or uint8."""
    slopes: tuple[float, ...]
    """Slopes in pixels per view step, [N]."""
    threads: int = 1
    """Number of threads that PyTorch may use."""

    def views(self, device: torch.device) -> Tensor:
        """Random views of that shape and type."""
        if self.dtype.is_floating_point:
            return torch.rand(self.shape, dtype=self.dtype, device=device)
        return torch.randint(256, self.shape, dtype=self.dtype, device=device)

    def run(self, views: Tensor) -> Tensor:
        """The stack of these views."""
        with torch.no_grad():
            return self.operator(views, torch.tensor(self.slopes, dtype=torch.float64))

    def small(self) -> "Workload":
        """The same call on a small field that these slopes allow."""
        n_rows, n_columns, channels, *size = self.shape
        # Slopes must shift by less than half a view; 8 pixels are room for interpolation.
        least = 2 * math.ceil(geometry.corner_shift(torch.tensor(self.slopes), (n_rows, n_columns))) + 8
        return replace(self, shape=(n_rows, n_columns, channels, *(min(length, least) for length in size)))


class Peak(NamedTuple):
    """Memory of one call."""

    extra_bytes: int
    """Highest use beyond the views; it includes the stack."""
    stack_bytes: int

    def ratio(self, workload: Workload) -> float:
        """Memory of views and call over the budget: twice the field in float32, and the stack; 1 is the limit."""
        n_samples = math.prod(workload.shape)
        return (n_samples * workload.dtype.itemsize + self.extra_bytes) / (2 * n_samples * 4 + self.stack_bytes)


def peak(workload: Workload, device: torch.device) -> Peak | None:
    """Highest memory use of a call; None on the CPU of a system without the `/proc` of Linux."""
    if device.type == "cuda" or not _can_measure():
        return _beyond_views(workload, device)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context, torch.set_num_threads, (workload.threads,)) as fresh:
        return fresh.submit(_beyond_views, workload, device).result()


def resident(device: torch.device) -> int | None:
    """Bytes that this process holds on the device, without freed memory; None as for `peak`."""
    if device.type == "cuda":
        torch.cuda.empty_cache()
        return torch.cuda.memory_allocated(device)
    if not _can_measure():
        return None
    memory.trim()  # a call that reuses freed memory would seem to need none
    return _status_bytes("VmRSS")


def highest(run: Callable[[], Result], device: torch.device) -> tuple[Result, int | None]:
    """Result of a call, and the most bytes that this process holds during it; None as for `peak`."""
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats(device)
        return run(), torch.cuda.max_memory_allocated(device)
    if not _can_measure():
        return run(), None
    (PROCESS / "clear_refs").write_text("5")  # resets the high-water mark
    return run(), _status_bytes("VmHWM")


def _beyond_views(workload: Workload, device: torch.device) -> Peak | None:
    if resident(device) is None:
        return None
    workload.small().run(workload.small().views(device))
    views = workload.views(device)
    before = resident(device)
    stack, most = highest(functools.partial(workload.run, views), device)
    assert before is not None
    assert most is not None
    return Peak(most - before, stack.nbytes)


def _can_measure() -> bool:
    return (PROCESS / "clear_refs").exists()


def _status_bytes(entry: str) -> int:
    match = re.search(rf"^{entry}:\s+(\d+) kB$", (PROCESS / "status").read_text(), re.MULTILINE)
    if match is None:
        raise OSError(f"no {entry} in {PROCESS / 'status'}")
    return int(match[1]) * 1024
