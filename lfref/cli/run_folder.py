"""One folder a run: made before anything runs, marked as ours, and never taken from another run unasked.

The mark (see `io.ownership`) lists what the run wrote. `overwrite=true` deletes what it lists, and nothing else; if a
listed file was edited, or the folder is no run folder, it is refused and nothing is deleted.
"""

import itertools
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf

from lfref.cli.exit_codes import fail
from lfref.errors import FileError, InputError, LfrefError
from lfref.io import ownership
from lfref.io import run as runs

NOTES = (ownership.MARK, runs.CONFIG, runs.OVERRIDES)
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
        overwrite: Delete what an earlier run wrote there; other files stay.

    Raises:
        FileError: The folder cannot be written, holds results, or (`overwrite`) is no run folder, or one whose files
            were edited.
    """
    make(folder)
    mark = ownership.read_mark(folder)
    if overwrite:
        ownership.delete_listed(folder, ownership.RUN)
    elif not _is_free(folder):
        is_run = mark is not None and mark.kind == ownership.RUN
        remedy = "choose another, or say overwrite=true" if is_run else "choose another"
        if runs.Run(folder).has_checkpoints:
            remedy = f"choose another, or go on by resume={folder}"
        raise FileError("output must be a new or an empty folder", got=str(folder), remedy=remedy)


@contextmanager
def marked(folder: Path) -> Iterator[None]:
    """Mark a folder as a run's, and list in the end, however it ends, what the run has written.

    Args:
        folder: The run folder.
    """
    # Files edited since an earlier run become the user's.
    listed = ownership.unchanged(folder, ownership.RUN)
    foreign = ownership.files_below(folder) - listed.keys()
    ownership.write_mark(folder, ownership.RUN, listed)
    try:
        yield
    finally:
        written = ownership.files_below(folder) - foreign
        ownership.write_mark(folder, ownership.RUN, ownership.digests(folder, written))


def list_also(folder: Path, part: Path) -> None:
    """List already now what a run has written: a killed one cannot do it in the end.

    Args:
        folder: The run folder.
        part: A folder in it that holds nothing else.
    """
    mark = ownership.read_mark(folder)
    listed = mark.files if mark is not None and mark.kind == ownership.RUN else {}
    prefix = part.relative_to(folder).as_posix()
    written = (f"{prefix}/{name}" for name in (*ownership.files_below(part), ownership.MARK))
    ownership.write_mark(folder, ownership.RUN, listed | ownership.digests(folder, written))


def is_first_process() -> bool:
    """Whether this process is the only one of its run, or the one of them that looks after the folder."""
    ranks = (os.environ.get(name, "0") for name in ("RANK", "LOCAL_RANK", "SLURM_PROCID"))
    return all(rank == "0" for rank in ranks)


def _is_free(folder: Path) -> bool:
    names = [path.name for path in folder.iterdir()]
    return not names or (ownership.MARK in names and all(name in NOTES or name.endswith(".log") for name in names))


SOURCES = ("input", "runs", "checkpoint", "white", "truth", "correct", "data.path", "data.validation_path")
"""Keys of configurations that name files of the user's."""


def refuse_inputs(config: DictConfig, folder: Path) -> None:
    """Refuse an output folder that is an input, or that contains one: `overwrite=true` could delete it.

    Raises:
        FileError: It is or does.
    """
    for key in SOURCES:
        value = OmegaConf.select(config, key, throw_on_missing=False)
        for name in [value] if isinstance(value, str) else value or ():
            # Of a pattern such as shots/*.exr, the folder before the first wildcard counts.
            fixed = itertools.takewhile(lambda part: not set("*?[") & set(part), Path(str(name)).parts)
            path = Path(*fixed).resolve()
            if path.exists() and (path == folder.resolve() or folder.resolve() in path.parents):
                expected = "output must be a folder that neither is nor contains an input"
                raise FileError(expected, got=f"{folder} with {key}={name}", remedy="choose another output")


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
            if not is_resumed:
                refuse_inputs(config, Path(config.hydra[mode].dir))
            prepare(Path(config.hydra[mode].dir), config.overwrite)
        except LfrefError as error:
            fail(config.hydra.job.name, error)
