"""Memory that is free, but that the C library keeps: given back, it does not add to the peak of the next step."""

import ctypes
import functools

from torch import Tensor

LARGE = 1 << 25
"""Samples of views, 128 MB, from which steps of an operator give memory back; for less it is not worth the time."""


def trim_for(views: Tensor) -> None:
    """Give freed memory back between two steps on these views, if they are `LARGE`."""
    if views.numel() >= LARGE:
        trim()


def trim() -> None:
    """Give freed memory back to the system, where the C library can (on Linux); it takes milliseconds."""
    if give_back := _malloc_trim():
        give_back(0)


@functools.cache
def _malloc_trim() -> "ctypes._NamedFuncPointer | None":
    try:
        return getattr(ctypes.CDLL(None), "malloc_trim", None)
    except (OSError, TypeError):  # Windows
        return None
