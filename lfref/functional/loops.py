"""Inner loops compiled by Numba, without the interpreter's lock, so that plain threads can share the work (`share`).

Machine code is kept for later runs. Numba itself notices changes in the file of a loop, but not in other files that the
loop uses: the sources of this part of the package are the stamp of the machine code.
"""

import functools
import hashlib
import itertools
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numba
import torch

LANES = 16
"""Number of values that loops process together: a register of 512 bits holds as many float32."""
PACKAGE = Path(__file__).parents[1]


@functools.cache
def stamp(part: Path) -> str:
    """SHA-256 of all sources in a folder and in this one: its loops use loops and constants of these."""
    files = sorted({*part.rglob("*.py"), *Path(__file__).parent.glob("*.py")})
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def compiling(**options: object) -> Callable[[Callable], Callable]:
    """A decorator that compiles a function, with options of `numba.njit`, and keeps the machine code if it can."""

    def decorate(function: Callable) -> Callable:
        jit = functools.partial(
            numba.njit, nogil=True, boundscheck=False, error_model="numpy", fastmath={"contract"}, **options
        )
        try:
            loop: Any = jit(cache=True)(function)
        except RuntimeError:  # neither the package's folder nor the user's folder can be written
            return jit()(function)
        file = Path(function.__code__.co_filename).resolve()
        part = next((folder for folder in file.parents if folder.parent == PACKAGE), file.parent)
        loop._cache._cache_file._source_stamp = stamp(part)
        return loop

    return decorate


compiled = compiling()
"""Decorator of loops."""
inlined = compiling(inline="always")
"""Decorator of steps within loops that take tables: a call would cost more than the work itself. Numba inlines them
before it compiles; inlined by the compiler (`forceinline`) they are compiled twice, which takes a third longer."""


def worthwhile(size: int, worth_a_thread: int) -> int:
    """Threads for work of some size, each worth so much of it: at least 1, at most PyTorch's number of threads."""
    return max(1, min(torch.get_num_threads(), size // worth_a_thread))


def bands(length: int, n_bands: int) -> list[tuple[int, int]]:
    """First item, and one past the last, of each of `n_bands` parts of a row of items, about equally long."""
    return list(itertools.pairwise(round(length * i / n_bands) for i in range(n_bands + 1)))


def share(work: Callable[..., None], jobs: Iterable[tuple[Any, ...]], n_threads: int) -> None:
    """Do all jobs, each once, in any order, in so many threads, the calling one among them; errors are raised here."""
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
