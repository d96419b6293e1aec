"""Inner loops compiled by Numba, without the interpreter's lock, so that plain threads can share the work.

Machine code is kept for later runs. Numba itself sees when the file of a loop changes, but not what the loop calls or
takes from other files: a digest of all of them is its stamp. The cache of light fields uses the same digest.
"""

import functools
import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

IMPORT = re.compile(r"^[ \t]*(?:from +([\w.]+) +import +(\([^)]*\)|[^(\n]*)|import +([\w.]+))", re.MULTILINE)


@functools.cache
def digest(file: Path, package: Path) -> str:
    """SHA-256 of a module's source and of all that it imports from its package, directly or not.

    Args:
        file: Of the module.
        package: Folder of its package; imports from elsewhere do not count.
    """
    files = [file]
    for known in files:  # the list grows meanwhile
        files += [other for other in imported(known, package) if other not in files]
    return hashlib.sha256(b"".join(sorted(path.read_bytes() for path in files))).hexdigest()


@functools.cache
def imported(file: Path, package: Path) -> list[Path]:
    """Files of a package that a file of it imports, inside functions too; arguments as of `digest`."""
    files: dict[Path, None] = {}
    for origin, names, whole in IMPORT.findall(file.read_text(encoding="utf-8")):
        for module in (whole or origin, *(f"{origin}.{name}" for name in re.findall(r"\w+", names))):
            if module.split(".")[0] == package.name:
                path = package.parent / module.replace(".", "/")
                files |= dict.fromkeys((path.with_suffix(".py"), path / "__init__.py"))
    return [path for path in files if path.is_file()]


def compiling(**options: object) -> Callable[[Callable], Callable]:
    """A decorator that compiles a function, and keeps the machine code for later runs if a folder can be written.

    Args:
        **options: Further options of `numba.njit`.
    """

    def decorate(function: Callable) -> Callable:
        jit = functools.partial(
            numba.njit, nogil=True, boundscheck=False, error_model="numpy", fastmath={"contract"}, **options
        )
        try:
            loop: Any = jit(cache=True)(function)
        except RuntimeError:  # neither the package's folder nor the user's can be written
            return jit()(function)
        file = Path(function.__code__.co_filename).resolve()
        package = file.parents[max(function.__module__.count(".") - 1, 0)]
        kept = loop._cache._cache_file
        kept._source_stamp = digest(file, package)
        load_index = kept._load_index

        def load_readable_index() -> dict:
            # Numba reads the types of the arguments before the stamp: those of an earlier version may be gone.
            try:
                return load_index()
            except (AttributeError, ImportError):
                return {}

        kept._load_index = load_readable_index
        return loop

    return decorate


compiled = compiling()
"""Decorator of loops."""
inlined = compiling(forceinline=True)
"""Decorator of steps within loops that take tables: a call would cost more than the work itself."""
