"""What ends a fit from outside, in one line: a full disk, a data process that died or stands still."""

import multiprocessing
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lfref.errors import CheckpointError, LfrefError, first_line
from lfref.io import atomic

KNOWN = {
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
    "Error(s) in loading state_dict": (
        CheckpointError,
        "the network must be the one of the checkpoint",
        "leave net as it was in the run that is resumed",
    ),
}
"""How the message of a RuntimeError begins -> what is raised instead: its class, what it says, and the remedy."""


@contextmanager
def explained(folder: Path) -> Iterator[None]:
    """Turn what a library raises in a fit into an error of one line.

    Args:
        folder: The run folder, which all that is written goes to.

    Raises:
        FileError: The disk refuses.
        LfrefError: A data process died or stood still.
        CheckpointError: A checkpoint does not fit the network.
    """
    try:
        with atomic.file_errors(folder, "written"):
            yield
    except RuntimeError as error:
        known = next((told for start, told in KNOWN.items() if str(error).startswith(start)), None)
        if known is None:
            raise
        # One that stands still would not even end, and be waited for at the exit of this process.
        for process in multiprocessing.active_children():
            process.kill()
        kind, expected, remedy = known
        raise kind(expected, got=first_line(error), remedy=remedy) from error
