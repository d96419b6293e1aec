"""The run folder of a command: config.yaml, overrides.yaml, and what `lfref train` writes (training.json, ...)."""

import csv
import itertools
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from lfref.errors import CheckpointError, FileError, first_line
from lfref.io import atomic

CONFIG, OVERRIDES = "config.yaml", "overrides.yaml"
NOTES = CONFIG, OVERRIDES
"""Files that a run writes before its results."""
CHECKPOINTS, METRICS = "checkpoints", "log/metrics.csv"
TRAINING = "training.json"
"""File with size, time, best value and end of a training."""
FOLDERS = "output", "folder", "resume", "overwrite"
"""Keys of overrides that say where a run lies."""


@dataclass(frozen=True)
class Run:
    """A run folder, and the checkpoint in it that the user chose, if any."""

    folder: Path
    chosen: Path | None = None

    @classmethod
    def of(cls, path: str | Path) -> "Run":
        """The run of a run folder `RUN`, or of a checkpoint `RUN/checkpoints/NAME.ckpt` in one."""
        place = Path(os.path.abspath(path))  # noqa: PTH100  `resolve` would follow links
        is_checkpoint = place.suffix == ".ckpt" or place.is_file()
        folder = place.parent.parent if is_checkpoint else place
        if not (folder / CONFIG).is_file() or (is_checkpoint and not place.is_file()):
            raise CheckpointError(f"{path} must be a run folder, or a checkpoint in one", got=f"none in {folder}")
        return cls(folder, place if is_checkpoint else None)

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.resolve().name

    @property
    def config(self) -> dict[str, Any]:
        """The configuration, resolved, as plain containers."""
        return dict(_read_yaml(self.folder / CONFIG))

    @property
    def has_begun(self) -> bool:
        """Whether a command has begun a run here."""
        return (self.folder / OVERRIDES).is_file()

    @property
    def overrides(self) -> list[str]:
        """The overrides of the command line, one `key=value` an entry."""
        return [str(override) for override in _read_yaml(self.folder / OVERRIDES)]

    @property
    def training(self) -> dict[str, Any]:
        """Number of parameters, seconds, device, best value and end of the training; empty if there is none."""
        path = self.folder / TRAINING
        return dict(json.loads(path.read_text("utf-8"))) if path.is_file() else {}

    @property
    def best(self) -> Path:
        """Checkpoint with the best validation."""
        return self._checkpoint("best.ckpt")

    @property
    def last(self) -> Path:
        """The newest checkpoint."""
        # A run that is killed at its first checkpoints may have only the best one, which is written before the last.
        is_there = (self.folder / CHECKPOINTS / "last.ckpt").is_file()
        return self._checkpoint("last.ckpt" if is_there else "best.ckpt")

    @property
    def has_checkpoints(self) -> bool:
        """Whether training wrote a checkpoint."""
        return any((self.folder / CHECKPOINTS).glob("*.ckpt"))

    @property
    def metrics(self) -> list[dict[str, float | None]]:
        """The rows that training logged, in order; empty cells are None."""
        path = self.folder / METRICS
        with atomic.file_errors(path, "read"), path.open(newline="", encoding="utf-8") as file:
            # A killed training may have cut off its last line.
            rows = [row for row in csv.DictReader(file) if None not in row.values()]
        # A training that went on from a checkpoint has logged the steps after it twice.
        later = list(itertools.accumulate((float(row["step"]) for row in reversed(rows)), min))[::-1]
        kept = [row for row, least in zip(rows, later, strict=True) if float(row["step"]) <= least]
        return [{name: float(cell) if cell else None for name, cell in row.items()} for row in kept]

    @property
    def is_finished(self) -> bool:
        """Whether training reached its end."""
        return bool(self.training.get("is_finished"))

    def _checkpoint(self, name: str) -> Path:
        if not (self.folder / CHECKPOINTS / name).is_file():
            raise CheckpointError(f"run {self.name} must have {CHECKPOINTS}/{name}", got="none")
        return self.folder / CHECKPOINTS / name


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


def _read_yaml(path: Path) -> Any:
    try:
        with atomic.file_errors(path, "read"):
            return yaml.safe_load(path.read_text("utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise FileError(f"{path} must be YAML", got=first_line(error)) from error
