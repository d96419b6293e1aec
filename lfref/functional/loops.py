"""Inner loops compiled by Numba, without the interpreter's lock, so that plain threads can share the work (`share`).

Machine code is kept for later runs. Numba itself notices changes in the file of a loop, but not in other files that the
loop uses: a digest of all these files is the stamp of the machine code.
"""

import functools
import hashlib
import itertools
import re
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numba
import torch

LANES = 16
"""Number of values that loops process together: a register of 512 bits holds as many float32."""

IMPORT = re.compile(r"^[ \t]*(?:from +([\w.]+) +import +(\([^)]*\)|[^(\n]*)|import +([\w.]+))", re.MULTILINE)


@functools.cache
def digest(file: Path, package: Path) -> str:
    """SHA-256 of a module's source and of all that it imports from its package, directly or not.

    Args:
        file: The module's file.
        package: Folder of its package; imports from elsewhere do not count.
    """
    files = [file]
    for known in files:  # the list grows meanwhile
        files += [other for other in imported(known, package) if other not in files]
    return hashlib.sha256(b"".join(sorted(path.read_bytes() for path in files))).hexdigest()


@functools.cache
def imported(file: Path, package: Path) -> list[Path]:
    """Files in the folder `package` that one of its files imports directly, at its top or inside functions."""
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
        except RuntimeError:  # neither the package's folder nor the user's folder can be written
            return jit()(function)
        file = Path(function.__code__.co_filename).resolve()
        package = file.parents[max(function.__module__.count(".") - 1, 0)]
        loop._cache._cache_file._source_stamp = digest(file, package)
        return loop

    return decorate


compiled = compiling()
"""Decorator of loops."""
inlined = compiling(inline="always")
"""Decorator of steps within loops that take tables: a call would cost more than the work itself. Numba inlines them
before it compiles; inlined by the compiler (`forceinline`) they are compiled twice, which takes a third longer."""


def worthwhile(size: int, worth_a_thread: int) -> int:
    """Number of threads for work of some size: at least 1, at most PyTorch's number of threads.

    Args:
        size: Size of the work.
        worth_a_thread: Size from which one more thread saves more than it costs.
    """
    return max(1, min(torch.get_num_threads(), size // worth_a_thread))


def bands(length: int, n_bands: int) -> list[tuple[int, int]]:
    """First item, and one past the last, of each of `n_bands` parts of a row of items, about equally long."""
    return list(itertools.pairwise(round(length * i / n_bands) for i in range(n_bands + 1)))


def share(work: Callable[..., None], jobs: Iterable[tuple[Any, ...]], n_threads: int) -> None:
    """Do all jobs, each once, in any order; errors of `work` are raised here.

    Args:
        work: Function that does one job.
        jobs: Arguments of each job.
        n_threads: Number of threads at work, including the calling thread.
    """
    waiting = list(jobs)
    n_others, queue = min(n_threads, len(waiting)) - 1, iter(waiting)

    def work_on() -> None:
        for job in queue:
            work(*job)

    if n_others < 1:
        work_on()
        return
    with ThreadPoolExecutor(n_others) as pool:
        others = [pool.submit(work_on) for _ in range(n_others)]
        work_on()
        for other in others:
            other.result()
