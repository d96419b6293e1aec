"""Inner loops compiled by Numba: without the interpreter's lock, so that plain threads can share the work."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

from lfref.functional import sources


def keeping(**options: object) -> Callable[[Callable], Callable]:
    """A decorator that compiles, and keeps the machine code for later runs where there is a place to keep it.

    Args:
        **options: Further options of `numba.njit`.
    """

    def decorated(function: Callable) -> Callable:
        jit = functools.partial(
            numba.njit, nogil=True, boundscheck=False, error_model="numpy", fastmath={"contract"}, **options
        )
        try:
            loop: Any = jit(cache=True)(function)
        except RuntimeError:  # neither the package's folder nor the user's can be written
            return jit()(function)
        # Numba itself sees that the file of a loop has changed, not what the loop calls or takes from other files.
        loop._cache._cache_file._source_stamp = _stamp(function)
        return loop

    return decorated


def _stamp(function: Callable) -> str:
    """The digest of what machine code of a function depends on."""
    file = Path(function.__code__.co_filename).resolve()
    return sources.digest(file, file.parents[max(function.__module__.count(".") - 1, 0)])


compiled = keeping()
"""For loops."""
inlined = keeping(forceinline=True)
"""For steps of loops that are handed tables: passing these on would cost more than the work itself."""
