"""Memory that is free, but that the C library keeps.

Given back, it does not add to the peak of the next step; kept, it need not be asked for anew.
"""

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


def release_for(views: Tensor) -> None:
    """Let the C library give blocks back as soon as they are freed, where it can (glibc), if views are `LARGE`.

    It keeps blocks as large as any that was freed before, up to 32 MB: with large views these add up.
    """
    if views.numel() >= LARGE and (set_option := _function("mallopt")) is not None:
        set_option(LEAST_MAPPED, 2**20)


@functools.cache
def keep() -> None:
    """Let the C library keep freed memory for the next request of any thread, where it can (glibc).

    Otherwise it gives large blocks back at once, and asks for them anew: the system fills new memory with zeros, which
    takes a quarter of the time of batches that are prepared one after the other.
    """
    if (set_option := _function("mallopt")) is not None:
        for option, value in KEEPING.items():
            set_option(option, value)


LEAST_MAPPED = -3
"""Option of glibc's `mallopt`: least block that is mapped on its own, and given back at once, in bytes."""
KEEPING = {LEAST_MAPPED: 2**30, -1: 2**31 - 1, -8: 1}
"""Options of glibc's `mallopt`: least block that is mapped on its own, and least free memory that is given back, in
bytes; number of arenas, of which those of threads cannot hold such blocks."""


@functools.cache
def _malloc_trim() -> "ctypes._NamedFuncPointer | None":
    return _function("malloc_trim")


def _function(name: str) -> "ctypes._NamedFuncPointer | None":
    """A function of the C library; None if it has none of that name."""
    try:
        return getattr(ctypes.CDLL(None), name, None)
    except (OSError, TypeError):  # Windows
        return None
