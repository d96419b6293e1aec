"""Inner loops compiled by Numba: without the interpreter's lock, so that plain threads can share the work."""

import contextlib
import functools
from collections.abc import Callable
from pathlib import Path

import numba


def forget_outdated(package: Path) -> None:
    """Delete machine code that is older than any source that machine code is kept of.

    Numba itself sees that the file of a loop has changed, not that a loop which it calls has, in another file.

    Args:
        package: A folder of Python files, and the folders in it.
    """
    kept = list(package.rglob("__pycache__/*.nbi"))
    sources = {path.parent.parent / f"{path.name.split('.')[0]}.py" for path in kept}
    last_change = max((source.stat().st_mtime for source in sources if source.exists()), default=0.0)
    for path in kept:
        with contextlib.suppress(OSError):  # gone by now, or not ours to delete
            if path.stat().st_mtime < last_change:
                path.unlink()


forget_outdated(Path(__file__).resolve().parents[1])


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
