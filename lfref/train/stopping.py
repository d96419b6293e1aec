"""The end of a training: all processes stop together when one process gets a signal or dies, and failures from outside
(a full disk, a dead or hanging data process) become errors of one line. Within long epochs, checkpoints are written
after some minutes, so that little is lost.

A handler must not start a collective: other processes may be in another one, and all would wait for ever. Lightning's
own notifier does so, and is switched off. Here a handler only sets a flag. The exchange of gradients carries the flags
of all processes along; if one is set, they write a checkpoint after that step, from which the epoch continues. A
process that stands still in a library is ended by force after `PATIENCE_S`. The checkpoint of the last epoch survives
that, since files are renamed only when they are whole.
The module stands apart from the command, since signals and processes are a separate subject.
"""

import math
import multiprocessing
import os
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from lightning.pytorch import Callback, Trainer
from torch import Tensor, distributed
from torch.distributed.algorithms.ddp_comm_hooks import default_hooks
from torch.futures import Future
from torch.nn.parallel import DistributedDataParallel

from lfref.errors import CheckpointError, LfrefError, first_line
from lfref.io import atomic

SIGNALS = (signal.SIGINT, signal.SIGTERM)
PATIENCE_S = 10
"""Seconds from a signal to an end by force."""
SAVE = 1
"""Value that the processes agree on, in place of a signal, to write a checkpoint and go on."""
REQUESTS = (*SIGNALS, SAVE)
"""What a process can ask of all processes, most urgent first."""
PARENT = "LFREF_FIRST_PROCESS"
"""Environment variable with the id of the process that started the other processes."""


class Stopping(Callback):
    """Stops all processes of a training after the step in which one of them got SIGINT or SIGTERM.

    Args:
        path: The checkpoint to write.
        give_up: Function that prints why a process ends by force; its argument is the reason, such as `stopped by
            SIGTERM`.
        minutes: Minutes between checkpoints within an epoch; None writes none.
    """

    def __init__(self, path: Path, give_up: Callable[[str], None], minutes: float | None = None) -> None:
        self.path = path
        self.give_up = give_up
        self.minutes = math.inf if minutes is None else minutes
        self._saved = time.monotonic()
        self.number = 0
        """The signal that this process got, or 0."""
        self.agreed = False
        """Whether all processes stop after the same step."""
        self._is_training = False
        self._requests: Tensor | None = None
        self._started: list[subprocess.Popen[bytes]] = []

    @contextmanager
    def listening(self, trainer: Trainer) -> Iterator[None]:
        """Handle signals while the trainer runs; a training in one process keeps the handlers that it has."""
        # Private, but without this line Lightning's handler of SIGTERM starts a broadcast under DDP, and elsewhere ends
        # the process with status 0, even where a launcher lets the job go on until it is queued again.
        trainer._signal_connector._sigterm_notifier_fn = lambda *_: None  # type: ignore[method-assign]
        if trainer.world_size == 1:
            yield
            return
        self._trainer = trainer
        self._previous = {number: signal.getsignal(number) for number in SIGNALS}
        self._owner = os.getpid()
        for number in SIGNALS:
            signal.signal(number, self._note)
        # Python runs handlers in the main thread, which may stand still in a library; this pair of sockets is read by
        # a thread of its own.
        ours, written = socket.socketpair()
        written.setblocking(False)
        before = signal.set_wakeup_fd(written.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=self._end_by_force, args=(ours,), daemon=True).start()
        self._has_ended = threading.Event()
        if trainer.global_rank == 0:
            os.environ[PARENT] = str(os.getpid())
            threading.Thread(target=self._watch_processes, daemon=True).start()
        elif os.environ.get(PARENT):
            threading.Thread(target=_end_with_parent, args=(int(os.environ[PARENT]),), daemon=True).start()
        try:
            yield
        except BaseException:
            self._end_others()
            raise
        finally:
            self._has_ended.set()
            signal.set_wakeup_fd(before)
            written.close()
            for number, handler in self._previous.items():
                signal.signal(number, handler)

    def on_train_start(self, trainer: Trainer, module: Any) -> None:
        """Note that all processes meet in every step from now on, and let them exchange requests there."""
        self._is_training = True
        if isinstance(model := trainer.strategy.model, DistributedDataParallel):
            model.register_comm_hook(None, self._exchange)

    def on_train_batch_end(self, trainer: Trainer, module: Any, outputs: Any, batch: Any, batch_index: int) -> None:
        """Write a checkpoint when one is due; if any process got a signal, also stop all processes."""
        # A checkpoint holds no gradients: gradients that are accumulated for a step would be lost.
        if (batch_index + 1) % trainer.accumulate_grad_batches:
            return
        latest = self._request() if self._requests is None else _most_urgent(self._requests)
        if not latest:
            return
        if latest != SAVE:
            self.agreed = True
            self._take_over_processes()
        # After the last batch, validation is due. A resumed training would leave it out, so it repeats the epoch.
        if not trainer.fit_loop.epoch_loop.batch_progress.is_last_batch:
            trainer.save_checkpoint(self.path, weights_only=False)
            self._saved = time.monotonic()
        if latest != SAVE:
            self._stop(latest)

    def on_train_end(self, trainer: Trainer, module: Any) -> None:
        """Note that the processes no longer meet: other processes may have ended."""
        self._is_training = False

    def _request(self) -> int:
        """What this process asks for: its signal, a checkpoint that is due, or 0."""
        is_due = time.monotonic() - self._saved > 60 * self.minutes
        return self.number or (SAVE if is_due else 0)

    def _exchange(self, state: None, bucket: distributed.GradBucket) -> Future[Tensor]:
        """Average gradients over the processes, as DDP does; the last ones of a step carry the requests along."""
        if not bucket.is_last():
            return default_hooks.allreduce_hook(None, bucket)  # type: ignore[arg-type]  # None: all processes
        own = torch.tensor([float(request == self._request()) for request in REQUESTS])
        both = torch.cat([bucket.buffer(), own.to(bucket.buffer())]).div_(distributed.get_world_size())

        def separate(future: Future[list[Tensor]]) -> Tensor:
            gradients, self._requests = future.value()[0].tensor_split([-len(REQUESTS)])
            return gradients

        return distributed.all_reduce(both, async_op=True).get_future().then(separate)

    def _note(self, number: int, frame: FrameType | None) -> None:
        """Handler of signals: remember the signal, or stop at once if no step follows."""
        is_first = not self.number
        if os.getpid() == self._owner:
            self.number = number
            self._take_over_processes()
        if os.getpid() != self._owner or not (self._is_training and is_first):  # a worker, or a second Ctrl-C
            self._stop(number)

    def _stop(self, number: int) -> None:
        previous = self._previous[signal.Signals(number)]
        assert callable(previous), "the command line has set a handler"
        previous(number, None)

    def _end_by_force(self, signals: socket.socket) -> None:
        """In a thread of its own, wait for a signal, and end the process if it still runs some seconds later."""
        with signals:
            while numbers := signals.recv(1):
                if numbers[0] in SIGNALS:
                    time.sleep(PATIENCE_S)
                    self.give_up(f"stopped by {signal.Signals(numbers[0]).name}")
                    self._end_others(patience_s=0)
                    os._exit(128 + numbers[0])

    def _watch_processes(self) -> None:
        """In a thread of its own, end this process too when one that it started has failed.

        Lightning's observer would do it without a word, by SIGKILL, some seconds later. This process may wait for the
        other one in a library, for example until all have connected, and would wait for long.
        """
        statuses: list[int] = []
        while not statuses:
            if self._has_ended.wait(0.2):
                return
            processes = getattr(self._trainer.strategy.launcher, "procs", None) or []
            statuses = [status for process in processes if (status := process.poll())]
        self._take_over_processes()
        number = statuses[0] - 128 if statuses[0] > 128 else -statuses[0]
        if number in SIGNALS:
            os.kill(os.getpid(), number)
        elif not self._has_ended.wait(PATIENCE_S / 2):
            self.give_up(f"all processes of a distributed training must live; got one that ended by {statuses[0]}")
            self._end_others(patience_s=0)
            os._exit(1)

    def _take_over_processes(self) -> None:
        """Take the processes that this process started from Lightning, whose observer would kill this process too.

        It does so when one of them ends with a status, which they do after a signal.
        """
        processes = getattr(self._trainer.strategy.launcher, "procs", None) or []
        self._started += processes
        processes.clear()

    def _end_others(self, patience_s: float = PATIENCE_S / 2) -> None:
        """Wait until the processes that this process started have ended, and kill those that do not end."""
        end = time.monotonic() + (patience_s if self.agreed else 0)
        self._take_over_processes()
        for process in self._started:
            while process.poll() is None and time.monotonic() < end:
                time.sleep(0.05)
            if process.poll() is None:
                process.kill()
                process.wait()


def _most_urgent(requests: Tensor) -> int:
    """The first of `REQUESTS` that a process asks for, or 0."""
    return next((request for request, share in zip(REQUESTS, requests.tolist(), strict=True) if share), 0)


def _end_with_parent(parent: int) -> None:
    """End this process when its parent has ended: otherwise it would wait for the parent in the next collective."""
    while os.getppid() == parent:
        time.sleep(1)
    os._exit(1)


DEAD_PROCESS = (
    LfrefError,
    "all processes of a distributed training must live",
    "look at what ended the other one, and go on from the last checkpoint by resume=RUN",
)
KNOWN: dict[str, tuple[type[LfrefError], str, str]] = {
    "DataLoader worker": (
        LfrefError,
        "a process that prepares batches has died",
        "most often memory ran out: lower data.workers or data.patch",
    ),
    "DataLoader timed out": (
        LfrefError,
        "a process that prepares batches has stood still for data.timeout seconds",
        "look at the disk that the data lies on, or raise data.timeout",
    ),
    "No working C++ compiler": (
        LfrefError,
        "compile=true must find a C++ compiler on a CPU",
        "install g++, or leave out compile=true",
    ),
    "closed by peer": DEAD_PROCESS,
    "reset by peer": DEAD_PROCESS,
    "NCCL": DEAD_PROCESS,
    "Error(s) in loading state_dict": (
        CheckpointError,
        "the network must be the one of the checkpoint",
        "leave net as it was in the run that is resumed",
    ),
}
"""Part of the message of a RuntimeError -> the error that is raised instead: class, expectation, remedy."""


@contextmanager
def one_line_errors(folder: Path) -> Iterator[None]:
    """Replace errors of libraries during a training by errors of one line.

    Args:
        folder: The run folder, to which all files are written.

    Raises:
        FileError: The disk refuses.
        LfrefError: A data process died or hangs.
        CheckpointError: A checkpoint does not fit the network.
        SystemExit: A signal came, whatever failed after it.
    """
    try:
        with atomic.file_errors(folder, "written"):
            yield
    except Exception as error:
        # After a signal, libraries clean up, and may fail over what they had not begun: the signal is what counts.
        if (end := _exit_behind(error)) is not None:
            raise end from None
        if not isinstance(error, RuntimeError):
            raise
        known = next((entry for part, entry in KNOWN.items() if part in str(error)), None)
        if known is None:
            raise
        # A process that hangs would never end, and this one would wait for it at its exit.
        for process in multiprocessing.active_children():
            process.kill()
        error_class, expected, remedy = known
        raise error_class(expected, got=first_line(error), remedy=remedy) from error


def _exit_behind(error: BaseException) -> SystemExit | None:
    """The end of the process during which an error occurred."""
    before = error.__context__
    while before is not None and not isinstance(before, SystemExit):
        before = before.__context__
    return before
