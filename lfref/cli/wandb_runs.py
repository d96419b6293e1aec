"""Runs in Weights & Biases: one for each training, also across a resume; sweeps as groups; checkpoints as artifacts.

The module stands apart from `loggers`, since configurations name its class.
"""

import logging
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import wandb
import yaml
from hydra.core.hydra_config import HydraConfig
from lightning.pytorch import loggers
from lightning.pytorch.callbacks import ModelCheckpoint
from omegaconf import DictConfig

from lfref.cli import resume
from lfref.errors import InputError
from lfref.io import atomic
from lfref.io import run as runs
from lfref.io.run import Run

log = logging.getLogger("lfref")

ID = "wandb_id.txt"
"""File in the run folder with the id of its run in wandb."""
TAGS = "experiment", "label", "net"
"""Choices of the configuration that become tags."""
LONGEST_NAME, LONGEST_TAG = 128, 64
"""Largest numbers of characters that wandb takes."""
ALIASES = "best", "last"
"""Names of checkpoints in the run folder, which are aliases of their artifacts."""
CHECKPOINT_FILE = "model.ckpt"
"""File of the artifact of a checkpoint."""


class WandbLogger(loggers.WandbLogger):
    """Lightning's logger, whose artifacts have the aliases `best` and `last` of the files in the run folder.

    Lightning's own calls each of them `best`: `last.ckpt` is the only and thus best file of its callback.
    """

    def __init__(self, *, offline: bool = False, **options: Any) -> None:
        # Lightning asks for offline runs by an environment variable, which wandb reads once in a process.
        mode = {"mode": "offline"} if offline else {}
        super().__init__(offline=offline, **mode | options)

    def _scan_and_log_checkpoints(self, checkpoint_callback: ModelCheckpoint) -> None:
        path = Path(checkpoint_callback.best_model_path)
        # The file is complete: `AtomicCheckpointIO` has renamed it before Lightning tells the loggers.
        if not path.is_file() or self._logged_model_time.get(str(path)) == path.stat().st_mtime:
            return
        self._logged_model_time[str(path)] = path.stat().st_mtime
        score = checkpoint_callback.best_model_score
        metadata = {"score": None if score is None else float(score), "original_filename": path.name}
        artifact = wandb.Artifact(_model_name(self.experiment.id), type="model", metadata=metadata)
        artifact.add_file(str(path), name=CHECKPOINT_FILE)
        self.experiment.log_artifact(artifact, aliases=[_alias(path)])


def options(logger: DictConfig, config: DictConfig, job_type: str = "train") -> dict[str, Any]:
    """What a logger of wandb gets beside its own settings: id, group, name, kind and tags of its run.

    Args:
        logger: The logger's settings, which go before these, except that tags are added.
        config: The configuration of the command.
        job_type: Kind of the run: the command.
    """
    own = {key: value for key, value in logger.items() if value is not None}
    choices = HydraConfig.get().runtime.choices if HydraConfig.initialized() else {}
    tags = [str(choices[group])[:LONGEST_TAG] for group in TAGS if choices.get(group)]
    known = {"job_type": job_type, "name": _name(), "group": _group(), "id": _kept_id(config)}
    if "version" in own:  # Lightning's other name of the id
        del known["id"]
    return {
        **{key: value for key, value in known.items() if value is not None and key not in own},
        "tags": list(dict.fromkeys([*own.get("tags", []), *tags])),
    }


def is_wandb(logger: DictConfig) -> bool:
    """Whether a configuration describes a logger of wandb."""
    return str(logger.get("_target_")).rpartition(".")[2] == WandbLogger.__name__


def keep_id(logger: Any, folder: Path) -> None:
    """Note the id of the run that a logger has started, so that a resumed training goes on in it."""
    atomic.write_text(folder / ID, f"{logger.version}\n")


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Turn errors of wandb at the start of a run into one line."""
    try:
        yield
    except wandb.errors.Error as error:
        remedy = "run wandb login, or set logger.wandb.offline=true"
        raise InputError("wandb must be able to start a run", got=error, remedy=remedy) from error


def _model_name(run_id: str) -> str:
    return f"model-{run_id}"


def _alias(checkpoint: Path) -> str:
    return checkpoint.stem if checkpoint.stem in ALIASES else "latest"


def _kept_id(config: DictConfig) -> str | None:
    """The id of the run that goes on in this folder; a run that is continued in another folder gets a new one."""
    path = Path(config.folder) / ID
    resumed = config.get("resume")
    is_resumed = resumed is not None and Run.of(resumed).is_in(config.folder)
    if not (is_resumed and path.is_file()):
        return None
    with atomic.file_errors(path, "read"):
        return path.read_text("utf-8").strip() or None


def _group() -> str | None:
    return Path(HydraConfig.get().sweep.dir).absolute().name if resume.is_sweep_job() else None


def _name() -> str | None:
    """The overrides by which a job of a sweep differs from the others, else those of the command."""
    if not HydraConfig.initialized():
        return None
    words = list(HydraConfig.get().overrides.task)
    if resume.is_sweep_job():
        given = _sweep_overrides(Path(HydraConfig.get().sweep.dir))
        words = [word for word in words if word not in given]
    return " ".join(_shown(words))[:LONGEST_NAME] or None


def _sweep_overrides(folder: Path) -> set[str]:
    """The overrides of the command that started a sweep, as Hydra notes them."""
    try:
        contents = yaml.safe_load((folder / "multirun.yaml").read_text("utf-8"))
        return set(contents["hydra"]["overrides"]["task"])
    except (OSError, yaml.YAMLError, KeyError, TypeError):
        return set()


def _shown(overrides: Iterable[str]) -> list[str]:
    """Overrides without those that say where files lie."""
    places = {*runs.FOLDERS, *resume.NOT_RESUMED, *resume.PLACES}
    return [word for word in overrides if "/" not in word and not places & {*re.split(r"[.@]", runs.key_of(word))}]
