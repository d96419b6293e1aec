"""Early ends of a command: one line for a user's mistake or a signal, and the exit status that shells expect."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, NoReturn, TextIO

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Stopped(SystemExit):
    """A signal that ends the process, with status 130 for SIGINT and 143 for SIGTERM.

    A command adds further text, such as the checkpoint to resume, by `add_note`.
    """

    def __init__(self, number: int) -> None:
        super().__init__(128 + number)
        self.status = 128 + number
        self.name = signal.Signals(number).name


def fail(name: str, error: object, status: int = 1) -> NoReturn:
    """Print the error of a command in one line and exit; status 1: the command failed, 2: wrong usage."""
    print(f"lfref {name}: {' '.join(str(error).split())}", file=sys.stderr)
    sys.exit(status)


@contextmanager
def exit_line_on_signals(name: str | None) -> Iterator[None]:
    """Let SIGINT and SIGTERM raise `Stopped`, and end the command with one line when it arrives here; None: without."""
    owner = os.getpid()

    def stop(number: int, _: FrameType | None) -> None:
        if os.getpid() == owner:
            raise Stopped(number)
        # A forked worker has inherited this handler, but prints nothing.
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)

    before = {number: signal.signal(number, stop) for number in SIGNALS}
    try:
        yield
    except Stopped as stopped:
        if name is None:
            sys.exit(stopped.status)
        fail(name, "; ".join([f"stopped by {stopped.name}", *getattr(stopped, "__notes__", [])]), stopped.status)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _Patient:
    """A stream whose reader may have gone."""

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        with suppress(BrokenPipeError):
            self.stream.write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(BrokenPipeError):
            self.stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


@contextmanager
def patient_pipes() -> Iterator[None]:
    """Let a reader of our output stop early, as `head` does: that is no error, and the work is finished."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = map(_Patient, before)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
        for stream in before:
            try:
                stream.flush()
            except BrokenPipeError:  # and Python itself flushes once more at its end
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
