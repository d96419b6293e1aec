"""The run folder of a command, and the files in it; only `lfref train` writes those after the first two.

RUN/config.yaml, overrides.yaml, training.json, checkpoints/best.ckpt, checkpoints/last.ckpt, log/metrics.csv,
pictures/*.png, wandb_id.txt
"""

import csv
import json
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import yaml

from lfref.errors import CheckpointError, FileError, first_line
from lfref.io import atomic

CONFIG, OVERRIDES, OLD_OVERRIDES = "config.yaml", "overrides.yaml", "overrides.txt"
CHECKPOINTS, METRICS, PICTURES = "checkpoints", "log/metrics.csv", "pictures"
TRAINING = "training.json"
"""File with size, time and end of a training."""
FAILURE = ".lfref_failure.json"
"""File in the folder of a failed job: jobs may run in other processes, which share nothing but files with the sweep."""
FOLDERS = "output", "folder", "resume"
"""Keys of overrides that say where a run lies."""

_NEXT_OVERRIDE = re.compile(r"\s+(?=~|\+{0,2}[\w./@:-]+=)")
"""Space between two overrides in the older file; values hold spaces too."""


@dataclass(frozen=True)
class Run:
    """A run folder, and the checkpoint in it that the user chose, if any."""

    folder: Path
    chosen: Path | None = None
    """The checkpoint if `of` got one; None if it got the folder."""

    @classmethod
    def of(cls, path: str | Path) -> "Run":
        """The run of a run folder `RUN`, or of a checkpoint `RUN/checkpoints/NAME.ckpt` in one."""
        place = Path(os.path.abspath(path))  # noqa: PTH100  `resolve` would follow links
        is_checkpoint = place.suffix == ".ckpt" or place.is_file()
        folder = place.parent.parent if is_checkpoint else place
        if is_checkpoint and not place.is_file():
            raise CheckpointError(
                f"no checkpoint at {path}", remedy=f"give a run folder, or RUN/{CHECKPOINTS}/last.ckpt"
            )
        if not (folder / CONFIG).is_file():
            kind = CheckpointError if is_checkpoint else FileError
            raise kind(f"{path} must be a run folder or a checkpoint in one", got=f"no {folder / CONFIG}")
        return cls(folder, place if is_checkpoint else None)

    def is_in(self, folder: str | Path) -> bool:
        """Whether this is the run of a folder, however its path is written."""
        return self.folder == Path(os.path.abspath(folder))  # noqa: PTH100  as in `of`

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.resolve().name

    @property
    def config(self) -> dict[str, Any]:
        """The configuration, resolved, as plain containers."""
        return _read_yaml(self.folder / CONFIG, dict)

    @property
    def title(self) -> str:
        """The overrides of the command line in one line; the name where no file holds them."""
        notes = (self.folder / OVERRIDES, self.folder / OLD_OVERRIDES)
        return " ".join(self.overrides) if any(note.is_file() for note in notes) else self.name

    @property
    def overrides(self) -> list[str]:
        """The overrides of the command line, one `key=value` an entry."""
        old = self.folder / OLD_OVERRIDES
        if (self.folder / OVERRIDES).exists() or not old.is_file():
            return _read_yaml(self.folder / OVERRIDES, list)
        return [override for override in _NEXT_OVERRIDE.split(old.read_text("utf-8").strip()) if override]

    @property
    def training(self) -> dict[str, Any]:
        """Number of parameters, seconds, device and end of the training; empty for a run of an older version."""
        return _read_json(self.folder / TRAINING)

    @property
    def failure(self) -> dict[str, Any]:
        """Why this job of a sweep failed: `overrides` and `reason`; empty if it did not."""
        return _read_json(self.folder / FAILURE)

    @property
    def best(self) -> Path:
        """Checkpoint with the best validation."""
        return self._checkpoint("best")

    @property
    def last(self) -> Path:
        """Checkpoint of the last finished epoch."""
        # A run that is killed at its first checkpoints may have only the best one, which is written before the last.
        return self._checkpoint("last", "best")

    @property
    def has_checkpoints(self) -> bool:
        """Whether training wrote a checkpoint."""
        return any((self.folder / CHECKPOINTS).glob("*.ckpt"))

    @property
    def metrics(self) -> list[dict[str, float | None]]:
        """The rows that training logged, in order; empty cells are None."""
        path = self.folder / METRICS
        with atomic.file_errors(path, "read"), path.open(newline="", encoding="utf-8") as file:
            rows = [row for row in csv.DictReader(file) if None not in row and None not in row.values()]
        return [{name: float(cell) if cell else None for name, cell in row.items()} for row in rows]

    @property
    def pictures(self) -> list[Path]:
        """Pictures of the held-out patch, one an epoch, in order."""
        return sorted((self.folder / PICTURES).glob("*.png"))

    @property
    def is_finished(self) -> bool:
        """Whether training reached its end."""
        if self.training.get("is_finished"):
            return True
        return self.has_checkpoints and is_trained(self.last, self.config.get("trainer", {}))

    def _checkpoint(self, *names: str) -> Path:
        folder = self.folder / CHECKPOINTS
        for path in (folder / f"{name}.ckpt" for name in names):
            if path.is_file():
                return path
        existing = ", ".join(sorted(file.name for file in folder.glob("*.ckpt"))) or "none"
        raise CheckpointError(f"run {self.name} must have {CHECKPOINTS}/{names[0]}.ckpt", got=existing)


def key_of(override: str) -> str:
    """The key that an override sets: `+net.width=3` and `net.width=4` have one key."""
    return override.partition("=")[0].lstrip("+~")


def run_name(path: Path) -> str:
    """Name of the run that a checkpoint belongs to: RUN/checkpoints/FILE.ckpt -> RUN; else the file's stem."""
    parent = path.resolve().parent
    return parent.parent.name if parent.name == CHECKPOINTS else path.stem


def write_overrides(folder: Path, overrides: list[str]) -> None:
    """Write the overrides of the command line."""
    atomic.write_text(folder / OVERRIDES, yaml.safe_dump(overrides, width=10_000, allow_unicode=True))


def epochs_done(checkpoint: Path) -> int:
    """Number of epochs of training before a checkpoint."""
    return int(_progress(checkpoint)["loops"]["fit_loop"]["epoch_progress"]["current"]["processed"])


def steps_done(checkpoint: Path) -> int:
    """Number of steps of the optimiser before a checkpoint."""
    return int(_progress(checkpoint)["global_step"])


def best_value(checkpoint: Path, monitor: str) -> float | None:
    """Best value of a metric such as `val/mpsnr` before a checkpoint; None if no callback of the training kept it."""
    states = [state for state in _progress(checkpoint).get("callbacks", {}).values() if isinstance(state, dict)]
    values = [state.get("best_model_score") for state in states if state.get("monitor") == monitor]
    return next((float(value) for value in values if value is not None), None)


def is_trained(checkpoint: Path, trainer: dict[str, Any]) -> bool:
    """Whether a checkpoint has reached `max_epochs` or `max_steps` of a trainer; a missing one or -1 sets no end."""
    done = {"max_epochs": epochs_done(checkpoint), "max_steps": steps_done(checkpoint)}
    lengths = {name: trainer.get(name) for name in done}
    return any(length is not None and 0 <= length <= done[name] for name, length in lengths.items())


def _progress(checkpoint: Path) -> dict[str, Any]:
    """Contents of a checkpoint with its training state; the tensors stay on the disk."""
    try:
        contents = torch.load(checkpoint, map_location="cpu", weights_only=True, mmap=True)
    # The unpickler may raise any error for a foreign file.
    except Exception as error:
        raise CheckpointError(f"{checkpoint} is damaged or no checkpoint") from error
    if not (isinstance(contents, dict) and {"loops", "global_step", "optimizer_states"} <= contents.keys()):
        raise CheckpointError(
            f"{checkpoint} holds a network but no training to resume", remedy=f"give RUN/{CHECKPOINTS}/last.ckpt"
        )
    return contents


def _read_yaml(path: Path, kind: type) -> Any:
    try:
        with atomic.file_errors(path, "read"):
            contents = yaml.safe_load(path.read_text("utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise FileError(f"{path} must be YAML", got=first_line(error)) from error
    if not isinstance(contents, kind):
        raise FileError(f"{path} must hold a {kind.__name__}", got=type(contents).__name__)
    return contents


def _read_json(path: Path) -> dict[str, Any]:
    """A JSON object; empty if there is no file."""
    if not path.is_file():
        return {}
    try:
        with atomic.file_errors(path, "read"):
            contents = json.loads(path.read_text("utf-8"))
    except ValueError as error:
        raise FileError(f"{path} must be JSON", got=first_line(error)) from error
    if not isinstance(contents, dict):
        raise FileError(f"{path} must hold an object", got=type(contents).__name__)
    return contents
