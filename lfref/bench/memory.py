"""Peak memory of one call: what it takes at its highest beyond the views it was given, the stack included.

PyTorch counts allocations on a GPU but not on the CPU. There the peak resident memory of a fresh process is read,
before and after the call, with the views in memory and the operator warmed up on a field of a few pixels, so that
libraries and compilation do not count. The process makes random views of its own: only a description travels.
"""

import ctypes
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

Result = TypeVar("Result")

PROCESS = Path("/proc/self")
MARGIN = 8  # pixels that a warm-up field is larger than the slopes demand


@dataclass(frozen=True)
class Workload:
    """A call, described so that another process can make it."""

    operator: Callable[[Tensor, Tensor], Tensor]
    """(views, slopes) -> stack; a function of a module, or a partial of one."""
    shape: tuple[int, ...]
    """Of the views, (V, U, C, H, W)."""
    dtype: torch.dtype
    """Of the views, float32 or uint8."""
    slopes: tuple[float, ...]
    """In pixels per view step, [N]."""
    threads: int = 1
    """Threads that PyTorch may use."""

    def views(self, device: torch.device) -> Tensor:
        """Random views of that shape and type."""
        if self.dtype.is_floating_point:
            return torch.rand(self.shape, dtype=self.dtype, device=device)
        return torch.randint(256, self.shape, dtype=self.dtype, device=device)

    def run(self, views: Tensor) -> Tensor:
        """Make the call."""
        with torch.no_grad():
            return self.operator(views, torch.tensor(self.slopes, dtype=torch.float64))

    def small(self) -> "Workload":
        """The same call on the smallest field that these slopes allow."""
        n_rows, n_columns, channels, *size = self.shape
        least = 2 * math.ceil(geometry.corner_shift(torch.tensor(self.slopes), (n_rows, n_columns))) + MARGIN
        return replace(self, shape=(n_rows, n_columns, channels, *(min(length, least) for length in size)))


class Peak(NamedTuple):
    """Memory of one call."""

    extra_bytes: int
    """What it takes at its highest beyond its views, the stack included."""
    stack_bytes: int
    """What it returns."""

    def ratio(self, workload: Workload) -> float:
        """Peak over what is allowed, at most 1: the views as given and the extra, over twice the field in float32 and
        the stack.

        Args:
            workload: The call.
        """
        n_samples = math.prod(workload.shape)
        return (n_samples * workload.dtype.itemsize + self.extra_bytes) / (2 * n_samples * 4 + self.stack_bytes)


def peak(workload: Workload, device: torch.device) -> Peak | None:
    """Memory that a call takes at its highest.

    Args:
        workload: The call.
        device: Where it is made.

    Returns:
        The peak; None on the CPU of a system that has no `/proc` of Linux.
    """
    if device.type == "cuda" or not _is_told():
        return _beyond_views(workload, device)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context, torch.set_num_threads, (workload.threads,)) as fresh:
        return fresh.submit(_beyond_views, workload, device).result()


def resident(device: torch.device) -> int | None:
    """Bytes that this process holds, freed memory given back first; None as for `peak`.

    Args:
        device: Whose memory: the GPU's, or the machine's.
    """
    if device.type == "cuda":
        torch.cuda.empty_cache()
        return torch.cuda.memory_allocated(device)
    if not _is_told():
        return None
    _return_freed_memory()
    return _status("VmRSS")


def highest(run: Callable[[], Result], device: torch.device) -> tuple[Result, int | None]:
    """What a call returns, and the bytes that this process holds at the highest during it; None as for `peak`.

    Args:
        run: The call.
        device: As for `resident`.
    """
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats(device)
        return run(), torch.cuda.max_memory_allocated(device)
    if not _is_told():
        return run(), None
    (PROCESS / "clear_refs").write_text("5")  # the highest so far is forgotten
    return run(), _status("VmHWM")


def _beyond_views(workload: Workload, device: torch.device) -> Peak | None:
    """Memory at its highest during the call, less that before it."""
    if resident(device) is None:
        return None
    workload.small().run(workload.small().views(device))
    views = workload.views(device)
    before = resident(device)
    stack, most = highest(functools.partial(workload.run, views), device)
    assert before is not None
    assert most is not None
    return Peak(most - before, stack.nbytes)


def _is_told() -> bool:
    """Whether the system tells what a process holds."""
    return (PROCESS / "clear_refs").exists()


def _return_freed_memory() -> None:
    """Give back what the C library keeps of freed memory: a call that reuses it would seem to need none."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def _status(entry: str) -> int:
    """An entry of the process's status in bytes."""
    found = re.search(rf"^{entry}:\s+(\d+) kB$", (PROCESS / "status").read_text(), re.MULTILINE)
    if found is None:
        raise OSError(f"no {entry} in {PROCESS / 'status'}")
    return int(found[1]) * 1024
