"""Room for arrays: in memory, or on a disk where they are larger than that."""

import math
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lfref.io import atomic

Room = Callable[[tuple[int, ...], DTypeLike], NDArray]
"""(shape, type) -> an array of zeros."""


def room(folder: Path | None) -> Room:
    """What makes room.

    Args:
        folder: Where files may lie that have no name and are gone with the arrays, or with the process; None: memory.

    Returns:
        Its arrays are as any others; of one on a disk, only what is used at a time is held in memory.
    """

    def on_disk(shape: tuple[int, ...], kind: DTypeLike) -> NDArray:
        with atomic.file_errors(folder or Path(), "written"), tempfile.TemporaryFile(dir=folder) as file:
            # All of it now: a disk that is full later would end the process without a word.
            _reserve(file.fileno(), max(1, math.prod(shape) * np.dtype(kind).itemsize))
            return np.memmap(file, kind, "r+", shape=shape)

    return np.zeros if folder is None else on_disk


def _reserve(descriptor: int, size: int) -> None:
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(descriptor, 0, size)
    else:
        os.truncate(descriptor, size)
