"""Plain threads that share work which lets go of the interpreter's lock: as many as asked for, gone when it is done."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Job = TypeVar("Job")


def share(work: Callable[[Job], None], jobs: Iterable[Job], n_threads: int) -> None:
    """Do all jobs, each once, in any order.

    Args:
        work: Does one; what it raises is raised here.
        jobs: What it is given.
        n_threads: How many work at once. The calling thread is one of them: were it to wait instead, the others might
            both be started on one core, and stay there.
    """
    queue = iter(list(jobs))

    def work_on() -> None:
        for job in queue:
            work(job)

    if n_threads <= 1:
        work_on()
        return
    with ThreadPoolExecutor(n_threads - 1) as pool:
        others = [pool.submit(work_on) for _ in range(n_threads - 1)]
        work_on()
        for other in others:
            other.result()
