"""Runs in Weights & Biases: one for each training, also across a resume; sweeps as groups; checkpoints as artifacts,
and the files that were exported from them.

The module stands apart from `loggers`, since configurations name its class.
"""

import base64
import hashlib
import logging
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import wandb
import yaml
from hydra.core.hydra_config import HydraConfig
from lightning.pytorch import loggers
from lightning.pytorch.callbacks import ModelCheckpoint
from omegaconf import DictConfig

from lfref.cli import config as configs
from lfref.cli import resume
from lfref.errors import InputError, first_line
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
EXPORT = "model-export"
"""Type of the artifact of an exported file."""


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


class LoggedCheckpoint(NamedTuple):
    """A checkpoint of a training that wandb knows."""

    id: str
    """Id of the training's run."""
    path: Path
    place: dict[str, str]
    """Project and entity of that run, as far as its run folder tells."""

    @property
    def artifact(self) -> str:
        """Name of the artifact that holds it if the training uploaded its checkpoints."""
        return f"{_model_name(self.id)}:{_alias(self.path)}"


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


def logged_checkpoint(path: Path) -> LoggedCheckpoint:
    """The checkpoint at RUN or RUN/checkpoints/NAME.ckpt; InputError if RUN has no run in wandb."""
    run = Run.of(path)
    note = run.folder / ID
    if not note.is_file():
        remedy = "train with logger=wandb, or export without a logger"
        raise InputError("logger=wandb needs a network whose training is in wandb", got=f"no {note}", remedy=remedy)
    with atomic.file_errors(note, "read"):
        name = note.read_text("utf-8").strip()
    trained = (run.config.get("logger") or {}).get("wandb") or {}
    place = {key: str(trained[key]) for key in ("project", "entity") if trained.get(key)}
    return LoggedCheckpoint(name, run.chosen or run.best, place)


@contextmanager
def exporting(config: DictConfig) -> Iterator[Callable[[Sequence[Path], str], None]]:
    """Go on in the run of the exported checkpoint; yields the function (files, alias) that logs the exported files.

    Raises:
        InputError: Other loggers are given, or the network is of no run in wandb, or wandb cannot start a run.
    """
    # The file in the run folder, `csv`, has nothing to log.
    if {*config.logger} - {"csv"} != {"wandb"}:
        raise InputError("logger of an export must be wandb", got=", ".join(config.logger))
    if config.checkpoint is None:
        raise InputError(
            "logger=wandb is for networks of a training", got="no checkpoint", remedy="give checkpoint=RUN"
        )
    checkpoint = logged_checkpoint(Path(config.checkpoint))
    # Neither name nor group nor configuration: those of the training stay.
    logger = configs.build(config.logger.wandb, id=checkpoint.id, **checkpoint.place)
    try:
        with one_line_errors():
            run = logger.experiment
        yield lambda files, alias: log_export(run, checkpoint, files, alias)
    finally:
        wandb.finish()


def log_export(run: Any, checkpoint: LoggedCheckpoint, files: Sequence[Path], alias: str) -> None:
    """Log exported files as an artifact, with the artifact of their checkpoint as its source.

    Args:
        run: The run of the training, which has been started again.
        checkpoint: What was exported.
        files: The files of the export.
        alias: Name of this form of the network, such as `onnx-fp32`.
    """
    digest = _digest(checkpoint.path)
    if not run.offline:
        _use(run, checkpoint.artifact, digest)
    metadata = {"checkpoint": checkpoint.artifact, "checkpoint_md5": digest, "checkpoint_file": checkpoint.path.name}
    artifact = wandb.Artifact(f"export-{checkpoint.id}", type=EXPORT, metadata=metadata)
    for path in files:
        artifact.add_file(str(path), name=path.name)
    run.log_artifact(artifact, aliases=[alias])


def _use(run: Any, name: str, digest: str) -> None:
    """Make an artifact an input of the run, so that wandb shows what was exported; warn if its digest differs."""
    try:
        used = run.use_artifact(name)
    except Exception as error:  # those of wandb's server have no class in common
        reason = f"{first_line(error)}; logger.wandb.log_model=true of lfref train uploads checkpoints"
        log.warning("wandb has no %s, so that the export has no source there: %s", name, reason)
        return
    entry = used.manifest.entries.get(CHECKPOINT_FILE)
    if entry is None or entry.digest != digest:
        log.warning("%s in wandb is not the checkpoint that was exported: it was uploaded before or after", name)


def _model_name(run_id: str) -> str:
    return f"model-{run_id}"


def _alias(checkpoint: Path) -> str:
    return checkpoint.stem if checkpoint.stem in ALIASES else "latest"


def _digest(path: Path) -> str:
    """MD5 of a file in base 64, by which wandb compares files."""
    with atomic.file_errors(path, "read"), path.open("rb") as file:
        return base64.b64encode(hashlib.file_digest(file, "md5").digest()).decode()


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
