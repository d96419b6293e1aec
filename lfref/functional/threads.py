"""Plain threads for work that releases the interpreter's lock; they end with the work."""

import itertools
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import torch

Item = TypeVar("Item")
_END: Any = object()


def worthwhile(size: int, worth_a_thread: int) -> int:
    """Number of threads for work of some size: at least 1, at most as many as PyTorch has.

    Args:
        size: Of the work.
        worth_a_thread: Size from which one more thread saves more than it costs.
    """
    return max(1, min(torch.get_num_threads(), size // worth_a_thread))


def bands(length: int, n_bands: int) -> list[tuple[int, int]]:
    """`n_bands` parts of a row of items, about equally long: first item and one past the last of each."""
    return list(itertools.pairwise(round(length * i / n_bands) for i in range(n_bands + 1)))


def share(work: Callable[..., None], jobs: Iterable[tuple[Any, ...]], n_threads: int) -> None:
    """Do all jobs, each once, in any order; errors of `work` are raised here.

    Args:
        work: Does one job.
        jobs: The arguments of each.
        n_threads: Threads at work, the calling one among them.
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
    """The same items in the same order; a thread computes the next item while one is in use.

    Nested steps (reading, computing, writing) then work at the same time, and at most one item waits between two steps.

    Args:
        items: An error in computing an item is raised where the item would be used.

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
