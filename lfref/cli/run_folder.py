"""One folder a run: made before anything runs, marked as ours, and never taken from another run unasked.

The mark lists what the run has written. `overwrite=true` deletes what a mark lists, and nothing else.
"""

import json
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from lfref.cli.exit_codes import fail
from lfref.errors import FileError, InputError, LfrefError
from lfref.io import atomic
from lfref.io import run as runs

MARK = ".lfref.json"
NOTES = (MARK, runs.CONFIG, runs.OVERRIDES)
"""What a run writes before its results: a folder with nothing else is free, so that a mistake costs no folder."""


def make(folder: Path, _: bool = False) -> None:
    """Make a folder, or find it and leave in it what there is.

    Raises:
        FileError: It cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ".writable").touch()
        (folder / ".writable").unlink()
    except OSError as error:
        got = f"{folder} ({error.strerror})"
        raise FileError("output must be a folder that can be written", got=got, remedy="set output=FOLDER") from error


def claim(folder: Path, overwrite: bool = False) -> None:
    """Make a folder for a new run.

    Args:
        folder: Where.
        overwrite: Delete what an earlier run has written there; what else lies there stays.

    Raises:
        FileError: It cannot be written, or holds what may not be replaced.
    """
    make(folder)
    if overwrite:
        _delete(folder)
    elif not _is_free(folder):
        remedy = "choose another, or say overwrite=true" if (folder / MARK).exists() else "choose another"
        if runs.Run(folder).has_checkpoints:
            remedy = f"choose another, or go on by resume={folder}"
        raise FileError("output must be a new or an empty folder", got=str(folder), remedy=remedy)


@contextmanager
def marked(folder: Path) -> Iterator[None]:
    """Mark a folder as a run's, and list in the end, however it ends, what the run has written.

    Args:
        folder: The run folder.
    """
    listed = {*_listed(folder)} & {*_files(folder)}
    before = {MARK, *_files(folder)} - listed
    _mark(folder, listed)
    try:
        yield
    finally:
        _mark(folder, {*_files(folder)} - before)


def list_also(folder: Path, part: Path) -> None:
    """List already now what a run has written: a killed one cannot do it in the end.

    Args:
        folder: The run folder.
        part: A folder in it that holds nothing else.
    """
    written = (f"{part.relative_to(folder).as_posix()}/{name}" for name in _files(part))
    _mark(folder, {*_listed(folder), *written})


def is_first_process() -> bool:
    """Whether this process is the only one of its run, or the one of them that looks after the folder."""
    ranks = (os.environ.get(name, "0") for name in ("RANK", "LOCAL_RANK", "SLURM_PROCID"))
    return all(rank == "0" for rank in ranks)


def _mark(folder: Path, names: Iterable[str]) -> None:
    atomic.write_text(folder / MARK, json.dumps({"written_by": "lfref", "files": sorted(names)}, indent=1) + "\n")


def _listed(folder: Path) -> list[str]:
    try:
        return [str(name) for name in json.loads((folder / MARK).read_text("utf-8"))["files"]]
    except (OSError, ValueError, KeyError, TypeError):
        return []


def _files(folder: Path) -> list[str]:
    return [path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir()]


def _is_free(folder: Path) -> bool:
    names = [path.name for path in folder.iterdir()]
    return not names or (MARK in names and all(name in NOTES or name.endswith(".log") for name in names))


def _delete(folder: Path) -> None:
    """Delete the listed files, and the folders that are empty then; a list that leads elsewhere is not followed."""
    if not (folder / MARK).is_file() and any(folder.iterdir()):
        raise FileError("overwrite=true replaces runs of lfref only", got=str(folder), remedy="choose another output")
    for name in _listed(folder):
        path = folder / name
        if path.is_file() and path.resolve().is_relative_to(folder.resolve()):
            path.unlink()
    for path in sorted(folder.rglob("*"), reverse=True):
        if path.is_dir() and not path.is_symlink() and not any(path.iterdir()):
            path.rmdir()


class OutputFolder(Callback):
    """Claims the output folder before Hydra makes it, so that a folder that cannot be used is one clear line."""

    def on_run_start(self, config: DictConfig, **_: Any) -> None:
        """Before a single run; one that resumes another, or helps its first process, takes the folder as it is."""
        is_new = is_first_process() and config.get("resume") is None
        self._prepare(config, "run", claim if is_new else make)

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        """Before a sweep, whose jobs have folders of their own."""
        self._prepare(config, "sweep", make)

    def _prepare(self, config: DictConfig, mode: str, prepare: Callable[[Path, bool], None]) -> None:
        # The folder may be named after the command, which Hydra itself makes known only later.
        HydraConfig.instance().set_config(config)
        try:
            is_resumed, trains = config.get("resume") is not None, config.hydra.job.name == "train"
            if config.overwrite and (mode == "sweep" or is_resumed or trains):
                remedy = "go on by resume=RUN, or choose another output"
                expected = "overwrite must be false for training, for sweeps, and where a run goes on"
                raise InputError(expected, got="true", remedy=remedy)
            prepare(Path(config.hydra[mode].dir), config.overwrite)
        except LfrefError as error:
            fail(config.hydra.job.name, error)
