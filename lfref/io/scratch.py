"""Arrays in memory, or in a nameless file where they are larger than memory; for the reader and for refocusers."""

import math
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lfref.io import atomic

Allocator = Callable[[tuple[int, ...], DTypeLike], NDArray]
"""(shape, type) -> an array of zeros."""


def allocator(folder: Path | None) -> Allocator:
    """The function that allocates arrays.

    Args:
        folder: Folder for files that have no name and vanish with the arrays, or with the process; None: memory.

    Returns:
        The allocator. Of an array on a disk only the part in use is held in memory.
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
