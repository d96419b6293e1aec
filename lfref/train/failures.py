"""Failures that end a training from outside, as errors of one line: a full disk, a dead or hanging data process."""

import multiprocessing
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lfref.errors import CheckpointError, LfrefError, first_line
from lfref.io import atomic

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
    """
    try:
        with atomic.file_errors(folder, "written"):
            yield
    except RuntimeError as error:
        known = next((entry for part, entry in KNOWN.items() if part in str(error)), None)
        if known is None:
            raise
        # A process that hangs would never end, and this one would wait for it at its exit.
        for process in multiprocessing.active_children():
            process.kill()
        error_class, expected, remedy = known
        raise error_class(expected, got=first_line(error), remedy=remedy) from error
