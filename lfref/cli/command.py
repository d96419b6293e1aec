"""Parts of all commands: one line for a user's mistake, a run folder with its configuration, progress, device."""

import itertools
import logging
import math
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, open_dict

from lfref.cli import config as configs
from lfref.cli import resume
from lfref.cli.exit_codes import Stopped, fail
from lfref.cli.run_folder import is_first_process, marked
from lfref.errors import InputError, LfrefError
from lfref.io import run as runs

if TYPE_CHECKING:
    from rich.progress import Progress

Task = Callable[[DictConfig, Path], None]
Prepare = Callable[[DictConfig, Path], bool]
Result = Callable[[DictConfig, Path], float | None]
Item = TypeVar("Item")

log = logging.getLogger("lfref")


def command(
    task: Task,
    prepare: Prepare = lambda config, folder: True,
    result: Result = lambda config, folder: None,
) -> Callable[[DictConfig], float | None]:
    """Make what `main` runs of a function (configuration, run folder).

    `prepare` (configuration, run folder) runs before the task, and returns False if there is nothing to do.
    `result` (configuration, run folder) is what a sweeper gets from a finished job, also from one that was finished
    before; a failed job returns NaN.
    """
    name = Path(task.__code__.co_filename).stem

    def run(config: DictConfig) -> float | None:
        folder = Path(HydraConfig.get().runtime.output_dir)
        with open_dict(config):
            config.folder = str(folder)
        try:
            if prepare(config, folder):
                with marked(folder) if is_first_process() else nullcontext():
                    if is_first_process():
                        configs.save(config, folder)
                        runs.write_overrides(folder, list(HydraConfig.get().overrides.task))
                    task(config, folder)
            return result(config, folder) if resume.is_sweep_job() else None
        except Stopped as stopped:
            # Training adds its checkpoint itself; a sweep goes on by its own command.
            goes_on = "resume" in config and name != "train" and not resume.is_sweep_job()
            if goes_on and (folder / runs.OVERRIDES).is_file():
                stopped.add_note(f"go on by lfref {name} resume={folder}")
            raise
        except Exception as error:
            if resume.is_sweep_job():
                resume.record_failure(error)
                return math.nan
            if isinstance(error, LfrefError):
                fail(name, error)
            if isinstance(error, OSError):
                fail(name, f"files must be readable and writable; got {error.filename or 'one'} ({error.strerror})")
            raise

    return run


def progress(items: Iterable[Item], what: str, total: int | None = None) -> Iterable[Item]:
    """Return items one by one, under a progress bar on a terminal; `total` is needed for items without a length."""
    with _bar() as bar:
        yield from items if bar is None else bar.track(items, total=total, description=what)


@contextmanager
def stages(name: str, number: int) -> Iterator[Callable[[str], None]]:
    """A progress bar of the stages of one light field, on a terminal; yields the function that begins a stage."""
    with _bar(counts_down=False, transient=True) as bar:
        if bar is None:
            yield lambda stage: None
            return
        task, n_begun = bar.add_task(name, total=number), itertools.count()
        yield lambda stage: bar.update(task, description=f"{name}: {stage}", completed=next(n_begun), refresh=True)


@contextmanager
def _bar(counts_down: bool = True, transient: bool = False) -> Iterator["Progress | None"]:
    """A progress bar below the lines of the log; None if there is no terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console  # imported here: commands without a terminal do not wait for it
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console, clock = Console(stderr=True), TimeRemainingColumn() if counts_down else TimeElapsedColumn()

    def make_room(_: logging.LogRecord) -> bool:
        console.file.write("\r\x1b[2K")  # erases the bar, which is drawn again below the line
        console.file.flush()
        return True

    handlers = logging.getLogger().handlers
    columns = TextColumn("{task.description}"), BarColumn(), clock
    with Progress(*columns, console=console, transient=transient) as bar:
        for handler in handlers:
            handler.addFilter(make_room)
        try:
            yield bar
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
