"""Inner loops compiled by Numba: without the interpreter's lock, so that plain threads can share the work."""

import functools
from collections.abc import Callable

import numba


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
            return jit(cache=True)(function)
        except RuntimeError:  # neither the package's folder nor the user's can be written
            return jit()(function)

    return decorated


compiled = keeping()
"""For loops."""
inlined = keeping(forceinline=True)
"""For steps of loops that are handed tables: passing these on would cost more than the work itself."""
