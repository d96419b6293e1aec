"""Train the networks of an experiment by `lfref train`: a process of one thread for each processor.

A network whose run is finished stays as it is, one that was interrupted goes on, one that was set up in another way is
refused.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from rich.progress import track

from lfref.cli.resume import FOLDERS, key_of, quoted
from lfref.io.run import Run

QUIET = ("~callbacks.progress", "~callbacks.summary", "~callbacks.pictures")


def train(wanted: Mapping[Path, Sequence[str]]) -> dict[Path, str]:
    """Train what is not trained yet.

    Args:
        wanted: Run folder -> what it is set up by, as on the command line.

    Returns:
        Run folder -> what went wrong, of those that failed.

    Raises:
        SystemExit: Another run lies in a folder.
    """
    left = {folder: overrides for folder, overrides in wanted.items() if not _is_done(folder, overrides)}
    print(f"{len(wanted) - len(left)} of {len(wanted)} networks are trained")
    with ThreadPoolExecutor(os.cpu_count()) as processors:
        errors = track(processors.map(train_one, left.keys(), left.values()), description="training", total=len(left))
        return {folder: error for folder, error in zip(left, errors, strict=True) if error}


def _is_done(folder: Path, overrides: Iterable[str]) -> bool:
    run = Run(folder)
    if not run.has_checkpoints:
        return False
    if (before := _setup(run.overrides)) != (now := _setup([*overrides, *QUIET])):
        raise SystemExit(f"{folder} holds a run of {' '.join(sorted(before ^ now))}: move it away, or delete it")
    return run.is_finished


def _setup(overrides: Iterable[str]) -> set[str]:
    return {override for override in overrides if key_of(override) not in FOLDERS}


def train_one(folder: Path, overrides: Sequence[str]) -> str:
    """Train one network unless it is trained; returns the end of its error output if it fails."""
    if _is_done(folder, overrides):
        return ""
    if Run(folder).has_checkpoints:
        words = [f"resume={folder}"]
    else:
        words = [*overrides, *QUIET, f"output={quoted(folder)}"]
        shutil.rmtree(folder, ignore_errors=True)  # a run that was stopped before its first epoch ended
    command = [sys.executable, "-m", "lfref.cli.main", "train", *words]
    one_thread = os.environ | {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    process = subprocess.run(command, env=one_thread, capture_output=True, text=True)
    return process.stderr[-2000:] if process.returncode else ""
