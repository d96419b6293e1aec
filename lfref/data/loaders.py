"""Loaders of batches: the order of an epoch, shared among processes and continued after a stop, and who prepares ahead.

Items are keyed by (epoch, index): a batch is the same whoever prepares it, and whenever.
"""

import itertools
import math
import multiprocessing.util
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from lightning.pytorch import LightningDataModule, Trainer
from torch.utils.data import DataLoader, Sampler
from torch.utils.data._utils import signal_handling
from torch.utils.data._utils.pin_memory import pin_memory

from lfref.errors import InputError, LfrefError
from lfref.functional import memory

BY_DEVICE = "auto"
"""Value of options that follow from the cores and the device of the network."""
MOST_WORKERS = 8
"""Threads or processes beyond which `auto` adds none: each keeps some batches in memory."""
AHEAD = 2
"""Batches that each thread prepares ahead."""


class EpochSampler(Sampler[tuple[int, int]]):
    """Yields (epoch, index), shuffled by (seed, epoch) and divided among the ranks of a distributed run.

    The key holds the epoch, so that persistent workers get it, and a resumed run draws the patches of an uninterrupted
    one. Without a seed (validation), the order is fixed and the epoch stays 0.
    """

    def __init__(self, n_items: int, seed: int | None, rank: int = 0, world_size: int = 1) -> None:
        self.n_items = n_items
        self.seed = seed
        self.rank = rank
        self.world_size = world_size
        self.epoch = 0
        self.skip = 0
        """Items of the next epoch that a resumed training has already processed."""

    def set_epoch(self, epoch: int) -> None:
        """Set the next epoch; Lightning calls this."""
        self.epoch = epoch

    def __len__(self) -> int:
        return len(self._order())

    def __iter__(self) -> Iterator[tuple[int, int]]:
        epoch = 0 if self.seed is None else self.epoch
        order, self.skip = self._order()[self.skip :], 0
        return ((epoch, index) for index in order)

    def _order(self) -> list[int]:
        if self.seed is None:
            # A rank without an item would block the other ranks: it repeats an item.
            return list(range(self.rank, self.n_items, self.world_size)) or [self.rank % self.n_items]
        order = np.random.default_rng((self.seed, self.epoch)).permutation(self.n_items).tolist()
        # All ranks must take equally many steps: wrap around to an even share.
        share = math.ceil(self.n_items / self.world_size)
        return [order[i % self.n_items] for i in range(self.rank, share * self.world_size, self.world_size)]


class EpochLoader(DataLoader[Any]):
    """A loader whose workers start at the first batch, and which can prepare batches in threads.

    Threads share memory with the training: nothing is copied from process to process. They suit work that releases
    Python's lock, such as copying samples and compiled loops.

    Lightning makes the iterator of a resumed training before it sets the epoch: workers that start with the iterator
    would prepare the data of epoch 0. Lightning also removes PyTorch's handler of SIGCHLD after a training: without it,
    the next training of the process notices a dead worker only after the timeout.

    Args:
        *arguments: Arguments of PyTorch's loader.
        n_threads: Threads that prepare batches; 0 prepares them in the calling thread, or in the worker processes.
        patience_s: Seconds after which a thread that still prepares one batch counts as standing still; 0: never.
        **options: Further arguments of PyTorch's loader.
    """

    def __init__(self, *arguments: Any, n_threads: int = 0, patience_s: float = 0.0, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.n_threads = n_threads
        self.patience_s = patience_s

    def __iter__(self) -> Iterator[Any]:  # type: ignore[override]
        if self.n_threads:
            yield from self._from_threads()
            return
        if self.num_workers and signal.getsignal(signal.SIGCHLD) == signal.SIG_DFL:
            signal_handling._SIGCHLD_handler_set = False
        yield from super().__iter__()

    def _from_threads(self) -> Iterator[Any]:
        """The batches in their order, prepared by threads a few batches ahead."""
        memory.keep()
        keys, waiting = iter(self.batch_sampler), deque[Future[Any]]()  # type: ignore[arg-type]
        # One core each: PyTorch would give every thread all cores.
        pool = ThreadPoolExecutor(self.n_threads, "batches", initializer=torch.set_num_threads, initargs=(1,))
        try:
            for batch in itertools.islice(keys, AHEAD * self.n_threads):
                waiting.append(pool.submit(self._prepare, batch))
            while waiting:
                try:
                    prepared = waiting.popleft().result(self.patience_s or None)
                except TimeoutError as error:
                    expected = f"batches must be prepared within {self.patience_s:g} s, data.timeout"
                    remedy = "look at the disk that the data lies on, or raise data.timeout"
                    raise LfrefError(expected, got="a thread that stands still", remedy=remedy) from error
                waiting.extend(pool.submit(self._prepare, batch) for batch in itertools.islice(keys, 1))
                yield prepared
        finally:
            pool.shutdown(wait=False, cancel_futures=True)

    def _prepare(self, keys: Sequence[tuple[int, int]]) -> Any:
        batch = self.collate_fn([self.dataset[key] for key in keys])
        return pin_memory(batch) if self.pin_memory else batch

    def state_dict(self) -> dict[str, Any]:
        """An empty state: the trainer tells `epoch_loader` where to continue. Lightning warns without this method."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Ignore the state, which is empty."""


def number_of_workers(workers: int | str, trainer: Trainer | None) -> int:
    """Threads or processes that prepare batches.

    Args:
        workers: Their number, or `auto`: one core less than the training has, at most `MOST_WORKERS`, if the network is
            on a GPU; one if it is on several cores, which it needs itself; none on a single core.
        trainer: Trainer of the network; None: the network is on the processor.

    Raises:
        InputError: It is neither a number >= 0 nor `auto`.
    """
    if workers == BY_DEVICE:
        # Lightning has shared the cores among the processes of a distributed training by now.
        n_cores = torch.get_num_threads()
        return min(MOST_WORKERS, max(1, n_cores - 1)) if is_on_gpu(trainer) else min(1, n_cores - 1)
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 0:
        raise InputError(f"workers must be {BY_DEVICE} or a number >= 0", got=repr(workers))
    return workers


def is_on_gpu(trainer: Trainer | None) -> bool:
    """Whether the network of a trainer, if there is one, is on a GPU."""
    return trainer is not None and bool(trainer.accelerator.name() == "cuda")


def epoch_loader(
    module: LightningDataModule,
    items: Any,
    order_seed: int | None,
    batch_size: int,
    collate: Callable[[Sequence[Any]], Any],
    workers: int | str,
    timeout: float = 0.0,
    in_threads: bool = True,
) -> DataLoader[Any]:
    """Batches of a data module, ordered by an `EpochSampler`.

    `timeout` is in seconds per batch of a worker (0: no limit).
    Batches are prepared by `workers` threads or processes (see `number_of_workers`); by 0, in the training itself.
    """
    trainer = module.trainer
    rank, world_size = (trainer.global_rank, trainer.world_size) if trainer else (0, 1)
    sampler = EpochSampler(len(items), order_seed, rank, world_size)
    if trainer and order_seed is not None and trainer.fit_loop.restarting:
        # The checkpoint may have been written in the middle of an epoch, when a signal came.
        epochs: Any = trainer.fit_loop.epoch_progress.total
        batches: Any = trainer.fit_loop.epoch_loop.batch_progress
        if epochs.processed < epochs.started and not batches.is_last_batch:
            sampler.skip = batches.current.processed * batch_size
    n_workers = number_of_workers(workers, trainer)
    n_processes = 0 if in_threads else n_workers
    return EpochLoader(
        items,
        batch_size=batch_size,
        sampler=sampler,
        collate_fn=collate,
        num_workers=n_processes,
        persistent_workers=n_processes > 0,
        worker_init_fn=_ignore_signals,
        timeout=timeout if n_processes else 0,
        n_threads=n_workers - n_processes,
        patience_s=timeout,
        pin_memory=is_on_gpu(trainer),
    )


def _ignore_signals(worker: int) -> None:
    """Let a worker process ignore SIGINT and SIGTERM, which terminals and SLURM send to all processes of a job.

    The training ends its step before it stops, and needs the batches for it.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


def _kill_workers() -> None:
    """Kill the workers that are left when the training exits: Python would ask them by SIGTERM, and wait for ever."""
    for process in multiprocessing.active_children():
        if process.daemon:
            process.kill()


multiprocessing.util.Finalize(None, _kill_workers, exitpriority=0)
