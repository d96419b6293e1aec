"""Plain threads for work which lets go of the interpreter's lock: as many as asked for, gone when it is done."""

import itertools
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import torch

Item = TypeVar("Item")
_END: Any = object()


def worthwhile(size: int, worth_a_thread: int) -> int:
    """How many threads work of some size is worth: at most as many as PyTorch has, at least 1.

    Args:
        size: Of the work.
        worth_a_thread: Size from which one more thread saves more than it costs.
    """
    return max(1, min(torch.get_num_threads(), size // worth_a_thread))


def bands(length: int, n_bands: int) -> list[tuple[int, int]]:
    """First item and one past the last of so many parts of a row of items, about as long as each other."""
    return list(itertools.pairwise(round(length * i / n_bands) for i in range(n_bands + 1)))


def share(work: Callable[..., None], jobs: Iterable[tuple[Any, ...]], n_threads: int) -> None:
    """Do all jobs, each once, in any order.

    Args:
        work: Does one; what it raises is raised here.
        jobs: The arguments of each.
        n_threads: How many work at once, the calling thread among them.
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


def ahead(items: Iterable[Item]) -> Iterator[Item]:
    """The same items in the same order, the next one made by a thread of its own while one is used.

    Steps that are wrapped so one around the other, reading, computing, writing, work at once on items that follow each
    other, and no more than one item waits between two of them.

    Args:
        items: What making one raises is raised where it would be used.

    Example:
        >>> list(threads.ahead(n * n for n in range(4)))
        [0, 1, 4, 9]
    """
    source = iter(items)
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(next, source, _END)
        while (item := coming.result()) is not _END:
            coming = pool.submit(next, source, _END)
            yield item
            del item
