"""Arrays in memory, or in a nameless file where they are larger than memory; for the reader and for refocusers."""

import math
import os
import re
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lfref.errors import InputError
from lfref.io import atomic

Allocator = Callable[[tuple[int, ...], DTypeLike], NDArray]
"""(shape, type) -> an array of zeros."""


def check_memory(n_bytes: float, what: str) -> None:
    """Refuse work that needs more memory than this process can get; Linux would kill it halfway, without a message."""
    if n_bytes > (limit := _available_memory()):
        got = f"{n_bytes / 1e9:.1f} GB for {limit / 1e9:.1f} GB"
        raise InputError(f"{what} must fit into memory", got=got, remedy="give reader.views, reader.size or rows=N")


def _available_memory() -> float:
    """Memory that this process can get, in bytes: the least of the machine's, the container's and its own limit."""
    limits = [math.inf]
    with suppress(OSError, TypeError):  # not on Linux
        entry = re.search(r"MemAvailable:\s+(\d+) kB", Path("/proc/meminfo").read_text())
        limits.append(int(entry[1]) * 1024)  # type: ignore[index]
    with suppress(OSError, ValueError):  # no container
        folder = Path("/sys/fs/cgroup")
        used = int((folder / "memory.current").read_text())
        limits.append(int((folder / "memory.max").read_text()) - used)
    with suppress(ImportError):  # Windows
        import resource

        own = resource.getrlimit(resource.RLIMIT_AS)[0]
        limits.append(math.inf if own == resource.RLIM_INFINITY else own)
    return min(limits)


def allocator(folder: Path | None) -> Allocator:
    """The function that allocates arrays: in memory, or in nameless files of a folder, which vanish with the arrays.

    Only the part in use of an array on a disk is held in memory.
    """
    if folder is None:
        return np.zeros

    def on_disk(shape: tuple[int, ...], kind: DTypeLike) -> NDArray:
        n_bytes = max(1, math.prod(shape) * np.dtype(kind).itemsize)
        with atomic.file_errors(folder, "written"), tempfile.TemporaryFile(dir=folder) as file:
            # Reserve all of it now: a disk that is full later would end the process without a message.
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, n_bytes)
            else:
                os.truncate(file.fileno(), n_bytes)
            return np.memmap(file, kind, "r+", shape=shape)

    return on_disk
