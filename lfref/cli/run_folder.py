"""One folder per run: it is made before anything runs, gets a mark, and replaces an earlier run only on request.

The mark (see `io.ownership`) lists what the run wrote. `overwrite=true` deletes the listed files, and nothing else. It
is refused, and deletes nothing, if a listed file was edited, or the folder is no run folder.
"""

import functools
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout
from hydra.core.hydra_config import HydraConfig
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf

from lfref.cli.exit_codes import fail
from lfref.errors import FileError, InputError, LfrefError
from lfref.io import ownership
from lfref.io import run as runs

LOCK = ".lfref.lock"
"""File that a process locks while it writes into a run folder; the system unlocks it when the process ends."""
FILES = "input", "runs", "checkpoint", "white", "truth", "correct", "splits", "data.path", "data.validation_path"
"""Keys of configurations that name the user's files."""
PATIENCE_S = 120
"""Seconds that further processes of a run wait for the first one to make the folder."""
NOTES = (ownership.MARK, runs.CONFIG, runs.OVERRIDES)
"""Files that a run writes before its results, besides the lock and logs. A folder with no other files counts as free,
so that a mistake in a command does not use up its output folder."""


def make(folder: Path, _: bool = False) -> None:
    """Make a folder; one that exists keeps its files.

    Raises:
        FileError: The folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ".writable").touch()
        (folder / ".writable").unlink(missing_ok=True)  # processes of one training do this at the same time
    except OSError as error:
        got = f"{folder} ({error.strerror})"
        raise FileError("output must be a folder that can be written", got=got, remedy="set output=FOLDER") from error


def wait_for_first_process(folder: Path, _: bool = False) -> None:
    """Wait until the first process of a distributed run has made the folder; they may start at once, as by `srun`.

    Raises:
        FileError: It has not done so for long.
    """
    end = time.monotonic() + PATIENCE_S
    while ownership.read_mark(folder) is None:
        if time.monotonic() > end:
            expected, got = "the first process must make the run folder", f"none in {PATIENCE_S} s: {folder}"
            raise FileError(expected, got=got, remedy="look at what that process says; give all the same output=FOLDER")
        time.sleep(0.1)
    make(folder)


_locks: list[FileLock] = []


def lock(folder: Path) -> None:
    """Lock a folder until this process ends or locks another one.

    Raises:
        FileError: Another process writes into the folder, or its disk has no locks.
    """
    unlock()
    new = FileLock(folder / LOCK)
    try:
        new.acquire(blocking=False)
    except Timeout as error:
        expected = "output must be a folder that no other run writes into"
        raise FileError(expected, got=str(folder), remedy="choose another, or wait for that run's end") from error
    except OSError as error:
        expected = "output must lie on a disk whose files can be locked"
        raise FileError(expected, got=f"{folder} ({error.strerror})", remedy="choose another disk") from error
    _locks.append(new)


def unlock() -> None:
    """Give up the lock, if there is one."""
    while _locks:
        _locks.pop().release()


def claim(folder: Path, overwrite: bool = False, overrides: Sequence[str] | None = None, goes_on: bool = False) -> None:
    """Make a folder for a new run.

    Args:
        folder: The run folder.
        overwrite: Delete what an earlier run wrote there; other files stay.
        overrides: Overrides of a training, else None. A folder is also free for a training if an earlier one with the
            same overrides ended there before its first checkpoint.
        goes_on: Whether the command can go on with a run (`resume`).

    Raises:
        FileError: The folder cannot be written, is in use, or holds results; with `overwrite`, it is no run folder, or
            its files were edited.
    """
    make(folder)
    # Check before the lock, so that a user's folder gets no file, and after it, so that only one run is first.
    for secure in (lambda _: None, lock):
        secure(folder)
        mark = ownership.read_mark(folder)
        if not (overwrite or _is_free(folder) or (mark is not None and _is_unborn(folder, overrides))):
            is_run = mark is not None and mark.kind == ownership.RUN
            # Training refuses overwrite=true: hours of work are deleted by hand only.
            remedy = "choose another, or give overwrite=true" if is_run and overrides is None else "choose another"
            if runs.Run(folder).has_checkpoints:
                remedy = f"choose another, or go on by resume={folder}"
            elif is_run and goes_on and (folder / runs.OVERRIDES).is_file():
                remedy = f"go on by resume={folder}, choose another, or give overwrite=true, which deletes its results"
            raise FileError("output must be a new or an empty folder", got=str(folder), remedy=remedy)
    if overwrite and not _is_free(folder):
        try:
            ownership.delete_listed(folder, ownership.RUN)
        except FileError:
            (folder / LOCK).unlink(missing_ok=True)
            raise


@contextmanager
def marked(folder: Path) -> Iterator[None]:
    """Mark a folder as a run folder; at the end, also after an error, list the files that the run has written.

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
        # Files that a killed run wrote but did not list are the run's own once it has written them again.
        listed_also = read_listed(folder).keys()
        written = ownership.files_below(folder) - (foreign - listed_also) - {LOCK}
        ownership.write_mark(folder, ownership.RUN, ownership.digests(folder, written))
        unlock()


def list_also(folder: Path, *parts: Path) -> None:
    """List files of a run before its end, since a killed run cannot do it at the end.

    Args:
        folder: The run folder.
        parts: Files in it, and folders in it that hold nothing else.
    """
    files: list[Path] = []
    for part in parts:
        files += [part / name for name in (*ownership.files_below(part), ownership.MARK)] if part.is_dir() else [part]
    names = (file.relative_to(folder).as_posix() for file in files)
    ownership.write_mark(folder, ownership.RUN, read_listed(folder) | ownership.digests(folder, names))


def read_listed(folder: Path) -> dict[str, str | None]:
    """The files that the mark of a run folder lists; none if it has no such mark."""
    mark = ownership.read_mark(folder)
    return mark.files if mark is not None and mark.kind == ownership.RUN else {}


def is_first_process() -> bool:
    """Whether this process is the only one of its run, or the one that manages the run folder."""
    ranks = (os.environ.get(name, "0") for name in ("RANK", "LOCAL_RANK", "SLURM_PROCID"))
    return all(rank == "0" for rank in ranks)


def _reopen(folder: Path, _: bool = False) -> None:
    """Make and lock a folder in which a run or sweep continues."""
    make(folder)
    lock(folder)


def _is_free(folder: Path) -> bool:
    names = {path.name for path in folder.iterdir()}
    others = {name for name in names if name != LOCK and not name.endswith(".log")}
    if ownership.MARK in names:
        return others <= set(NOTES)
    # Only a free folder is locked. A run that was refused before it marked the folder leaves the lock and a log.
    return not others and (LOCK in names or not names)


def _is_unborn(folder: Path, overrides: Sequence[str] | None) -> bool:
    """Whether a training by these overrides ended before its first checkpoint."""
    run = runs.Run(folder)
    with suppress(FileError):
        return (folder / runs.OVERRIDES).is_file() and not run.has_checkpoints and run.overrides == overrides
    return False


def pattern_folder(path: Path) -> Path | None:
    """The longest folder of a pattern such as `shots/*.exr` that exists; None if a path is no pattern.

    Folders that exist may have brackets or stars in their own names: only what follows them is a pattern.
    """
    if path.exists() or not set("*?[") & set(str(path)):
        return None
    return next(parent for parent in path.absolute().parents if parent.exists())


def refuse_inputs(config: DictConfig, folder: Path) -> None:
    """Refuse an output folder that is an input, or that contains one: `overwrite=true` could delete it.

    Raises:
        FileError: The output folder is an input or contains one.
    """
    for key in FILES:
        value = OmegaConf.select(config, key, throw_on_missing=False)
        for name in [value] if isinstance(value, str) else value or ():
            # Of a pattern such as shots/*.exr, the folder counts.
            path = (pattern_folder(Path(str(name))) or Path(str(name))).resolve()
            if path.exists() and (path == folder.resolve() or folder.resolve() in path.parents):
                expected = "output must be a folder that neither is nor contains an input"
                raise FileError(expected, got=f"{folder} with {key}={name}", remedy="choose another output")


class OutputFolder(Callback):
    """Claims the output folder before Hydra makes it, so that an unusable folder gives one clear line."""

    def on_run_start(self, config: DictConfig, **_: Any) -> None:
        """Claim the output folder of a run; a resumed run and further processes of one use it as it is."""
        resumed = config.get("resume")
        if not is_first_process():
            self._prepare(config, "run", wait_for_first_process)
        elif resumed is not None and runs.Run.of(resumed).is_in(config.hydra.run.dir):
            self._prepare(config, "run", _reopen)
        else:
            overrides = list(config.hydra.overrides.task) if config.hydra.job.name == "train" else None
            self._prepare(config, "run", functools.partial(claim, overrides=overrides, goes_on="resume" in config))

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        """Make and lock the folder of a sweep, whose jobs have folders of their own."""
        self._prepare(config, "sweep", _reopen)

    def _prepare(self, config: DictConfig, mode: str, prepare: Callable[[Path, bool], None]) -> None:
        # The name of the folder may depend on the command, which Hydra itself sets only later.
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
