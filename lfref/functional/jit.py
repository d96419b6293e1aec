"""Inner loops compiled by Numba: without the interpreter's lock, so that plain threads can share the work."""

import functools
import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

# PART sources
# Which files of a package a module is made of: its own, and whatever these import from the package.

IMPORT = re.compile(r"^[ \t]*(?:from +([\w.]+) +import +(\([^)]*\)|[^(\n]*)|import +([\w.]+))", re.MULTILINE)


@functools.cache
def digest(file: Path, package: Path) -> str:
    """What changes with the text of any of these files, and with nothing else.

    Args:
        file: Of the module.
        package: Folder of its package; what is imported from elsewhere does not count.
    """
    files = [file]
    for each in files:  # which grows meanwhile
        files += [other for other in imported(each, package) if other not in files]
    return hashlib.sha256(b"".join(sorted(each.read_bytes() for each in files))).hexdigest()


@functools.cache
def imported(file: Path, package: Path) -> list[Path]:
    """Files of a package that a file of it imports, inside functions too; arguments as of `digest`."""
    found: dict[Path, None] = {}
    for origin, names, whole in IMPORT.findall(file.read_text(encoding="utf-8")):
        for module in (whole or origin, *(f"{origin}.{name}" for name in re.findall(r"\w+", names))):
            if module.split(".")[0] == package.name:
                path = package.parent / module.replace(".", "/")
                found |= dict.fromkeys((path.with_suffix(".py"), path / "__init__.py"))
    return [path for path in found if path.is_file()]


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
    return digest(file, file.parents[max(function.__module__.count(".") - 1, 0)])


compiled = keeping()
"""For loops."""
inlined = keeping(forceinline=True)
"""For steps of loops that are handed tables: passing these on would cost more than the work itself."""
