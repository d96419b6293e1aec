"""What all commands share: Hydra around a function, one line for a user's mistake, a run folder with its config."""

import functools
import logging
import sys
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import hydra
import torch
from hydra.core.hydra_config import HydraConfig
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, open_dict
from rich.console import Console
from rich.progress import track

from lfref.cli import config as configs
from lfref.cli import members
from lfref.errors import InputError, LfrefError
from lfref.io import run as runs

Task = Callable[[DictConfig, Path], None]
Claim = Callable[[DictConfig, Path], bool]
Item = TypeVar("Item")

console = Console(stderr=True)
log = logging.getLogger("lfref")


def command(task: Task, claim: Claim = lambda config, folder: True) -> Callable[[], None]:
    """Make a command of a function: its configuration is `conf/NAME.yaml`, its output one run folder.

    Args:
        task: Takes the configuration and the run folder; its module's name is the command's.
        claim: Takes the same before anything is written into the folder; False if there is nothing to do.
    """
    name = Path(task.__code__.co_filename).stem

    @functools.wraps(task)
    def guarded(config: DictConfig) -> None:
        try:
            folder = Path(HydraConfig.get().runtime.output_dir)
            with open_dict(config):
                config.folder = str(folder)
            if claim(config, folder):
                configs.save(config, folder)
                runs.write_overrides(folder, list(HydraConfig.get().overrides.task))
                task(config, folder)
        except Exception as error:
            if members.is_followed():
                members.failed(error)
            elif isinstance(error, LfrefError):
                fail(name, error)
            else:
                raise

    started = hydra.main(version_base="1.3", config_path=str(configs.directory()), config_name=name)(guarded)

    def main() -> None:
        started()
        members.finish(name)

    return main


def fail(name: str, error: object) -> None:
    """Say in one line what went wrong, and leave with status 1."""
    print(f"lfref {name}: {' '.join(str(error).split())}", file=sys.stderr)
    sys.exit(1)


def progress(items: Iterable[Item], what: str) -> Iterable[Item]:
    """Pass items on under a progress bar."""
    return track(items, description=what, console=console)


def device_of(name: str) -> torch.device:
    """The device of that name; `auto` is a GPU where there is one.

    Raises:
        InputError: There is no such device here.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise InputError("device must be auto, cpu, or a GPU of this machine", got=repr(name)) from error
    return device


def quiet_libraries() -> None:
    """Silence what libraries say about settings that are ours on purpose, and their advertisements."""
    logging.getLogger("lightning.pytorch.utilities.rank_zero").setLevel(logging.WARNING)
    for message in (
        ".*does not have many workers.*",
        ".*isinstance.treespec, LeafSpec.*",
        ".*number of training batches.*",
    ):
        warnings.filterwarnings("ignore", message=message)


def paths(value: str | Sequence[str] | None) -> list[Path]:
    """One path, several, or none, as a list."""
    if value is None:
        return []
    return [Path(value)] if isinstance(value, str) else [Path(each) for each in value]


class OutputFolder(Callback):
    """Makes the output folder before Hydra does, so that a folder that cannot be written is one clear line."""

    def on_run_start(self, config: DictConfig, **_: Any) -> None:
        """Before a single run."""
        self._make(config, "run")

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        """Before a sweep."""
        self._make(config, "sweep")

    def _make(self, config: DictConfig, mode: str) -> None:
        # The folder may be named after the command, which Hydra itself makes known only later.
        HydraConfig.instance().set_config(config)
        folder = Path(config.hydra[mode].dir)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / ".writable").touch()
            (folder / ".writable").unlink()
        except OSError as error:
            got = f"got {folder} ({error.strerror})"
            fail(config.hydra.job.name, f"output must be a folder that can be written; {got}; set output=FOLDER")
