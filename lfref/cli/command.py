"""Parts of all commands: a run folder with its configuration, one line for a user's mistake, progress, device."""

import logging
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import torch
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, open_dict

from lfref.cli import config as configs
from lfref.cli.main import fail
from lfref.errors import FileError, InputError, LfrefError
from lfref.io import run as runs
from lfref.io.run import Run, key_of

Task = Callable[[DictConfig, Path], float | None]
Item = TypeVar("Item")

log = logging.getLogger("lfref")


def command(task: Task) -> Callable[[DictConfig], float | None]:
    """Make what Hydra runs of a function (configuration, run folder), which returns what a sweeper compares jobs by."""
    name = Path(task.__code__.co_filename).stem

    def run(config: DictConfig) -> float | None:
        folder, overrides = Path(HydraConfig.get().runtime.output_dir), list(HydraConfig.get().overrides.task)
        with open_dict(config):
            config.folder = str(folder)
        try:
            claim(config, folder, overrides)
            if is_first_process():
                configs.save(config, folder)
                runs.write_overrides(folder, overrides)
            return task(config, folder)
        except (LfrefError, OSError) as error:
            if is_sweep_job():  # Hydra goes on with the other jobs, and names this one at the end
                log.error("%s failed: %s", folder, error)
                raise
            if isinstance(error, LfrefError):
                fail(name, error)
            fail(name, f"files must be readable and writable; got {error.filename or 'one'} ({error.strerror})")

    return run


def claim(config: DictConfig, folder: Path, overrides: Sequence[str]) -> None:
    """Refuse a folder that has files, unless the run goes on there; a job of a sweep that ran before goes on."""
    before = Run(folder)
    if is_sweep_job() and before.has_begun:
        if _decisive(before.overrides) != _decisive(overrides):
            expected = f"{folder} must hold the same job of the sweep"
            raise InputError(expected, got=" ".join(before.overrides), remedy="give another output")
        if "resume" in config:
            config.resume = str(folder)
    elif is_first_process() and not (config.overwrite or config.get("resume")):
        # A command that failed before it wrote results leaves its folder free.
        others = [path.name for path in folder.iterdir() if path.suffix != ".log" and path.name not in runs.NOTES]
        if others:
            goes_on = f"resume={folder}, " if "resume" in config and before.has_begun else ""
            remedy = f"choose another, or give {goes_on}or overwrite=true, which writes over equal names"
            raise FileError(f"output must be a new or an empty folder; {folder} is not", got=others[0], remedy=remedy)


def is_sweep_job() -> bool:
    """Whether this process runs a job of a sweep."""
    return HydraConfig.initialized() and HydraConfig.get().mode == RunMode.MULTIRUN


def is_first_process() -> bool:
    """Whether this process is the only one of its run, or the one that manages the run folder."""
    return all(os.environ.get(name, "0") == "0" for name in ("RANK", "LOCAL_RANK", "SLURM_PROCID"))


def _decisive(overrides: Sequence[str]) -> list[str]:
    return [word for word in overrides if key_of(word) not in runs.FOLDERS]


def progress(items: Iterable[Item], what: str, total: int | None = None) -> Iterator[Item]:
    """Return items one by one, under a progress bar on a terminal; `total` is needed for items without a length."""
    if not sys.stderr.isatty():
        yield from items
        return
    from rich.console import Console  # imported here: commands without a terminal do not wait for it
    from rich.progress import Progress

    console = Console(stderr=True)

    def make_room(_: logging.LogRecord) -> bool:
        console.file.write("\r\x1b[2K")  # erases the bar, which is drawn again below the line
        console.file.flush()
        return True

    handlers = logging.getLogger().handlers
    with Progress(console=console) as bar:
        for handler in handlers:
            handler.addFilter(make_room)
        try:
            yield from bar.track(items, total=total, description=what)
        finally:
            for handler in handlers:
                handler.removeFilter(make_room)


def device_of(name: str) -> torch.device:
    """The device of that name; `auto` is a GPU where there is one."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise InputError("device must be auto, cpu, or a GPU of this machine", got=repr(name)) from error
    return device


def quiet_libraries() -> None:
    """Silence warnings of libraries about settings that we chose, and their advertisements."""
    logging.getLogger("lightning.pytorch.utilities.rank_zero").setLevel(logging.WARNING)
    for message in (
        ".*does not have many workers.*",
        ".*isinstance.treespec, LeafSpec.*",
        ".*number of training batches.*",
        "Checkpoint directory .* exists and is not empty.*",
        "The dirpath has changed from .*",
        "The `srun` command is available on your system but is not used.*",
    ):
        warnings.filterwarnings("ignore", message=message)


def paths(value: str | Sequence[str] | None) -> list[Path]:
    """An option that holds one path, several, or none, as a list."""
    if value is None:
        return []
    return [Path(value)] if isinstance(value, str) else [Path(path) for path in value]
