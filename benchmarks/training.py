"""Train a network of an experiment by `lfref train`, in a process of one thread."""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from lfref.cli.main import _quoted as quoted
from lfref.io.run import Run

QUIET = ("~callbacks.progress", "~callbacks.summary", "~callbacks.pictures", "data.workers=0")


def train(folder: Path, overrides: Sequence[str]) -> None:
    """Train a network; one that is finished stays as it is, one that was interrupted goes on.

    Args:
        folder: Its run folder.
        overrides: What it is set up by, as on the command line.

    Raises:
        SystemExit: The training fails.
    """
    if Run(folder).is_finished:
        return
    words = [*overrides, *QUIET, f"output={quoted(folder)}", "resume=auto"]
    one_thread = os.environ | {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "lfref.cli.main", "train", *words]
    process = subprocess.run(command, env=one_thread, capture_output=True, text=True)
    if process.returncode:
        raise SystemExit(f"{folder}: {process.stderr[-2000:]}")
