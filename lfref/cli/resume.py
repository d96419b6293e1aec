"""`resume=RUN` of `lfref train` and `lfref refocus`, and sweeps that continue.

Before Hydra reads the command line, `resume=RUN` becomes the overrides of that run and its folder; overrides that
follow replace those with the same key. The result is then compared with what the run was trained on. Sweeps skip
finished jobs when rerun, and continue after a failed one, with any launcher.
"""

import json
import logging
import re
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig

from lfref.cli import config as configs
from lfref.errors import CheckpointError, InputError, LfrefError
from lfref.io import atomic
from lfref.io import run as runs
from lfref.io.run import FAILURE, FOLDERS, Run, key_of

KEY, OUTPUT = "resume=", "output="
AUTO = "auto"
"""Value of `resume` that goes on with the run in `output`, if there is one: one command for a job that a cluster starts
again."""
PROTECTED = "task", "recipe", "planes", "reader", "label", "scene", "data", "net", "loss", "seed"
"""Parts of a configuration that must stay as they are when a run is resumed."""
FREE = "_target_", "allow_changes", "cache_folder", "workers", "labels_on", "timeout", "optimizer", "scheduler"
"""Entries in these parts that may change: they do not change what is learned, or are compared in another way."""
SHOWN = 4
"""Largest number of differences that an error names."""
NOT_RESUMED = "hydra", "logger", "output", "folder", "overwrite"
"""Groups of overrides that say where files go. They are not taken over: a run folder may come from somebody else."""
PLACES = "dirpath", "save_dir", "folder", "default_root_dir", "offline_directory", "cache_folder", "tracking_uri"
"""Last names of keys in other groups that say where files go."""


def expanded(command: str, arguments: list[str]) -> list[str]:
    """The command line with `resume=RUN` replaced by the overrides of that run; any other line is unchanged.

    `resume` becomes the folder of the run; of a training the checkpoint that was chosen, else the last one.

    Args:
        command: Its name.
        arguments: Command line after the command's name.

    Raises:
        CheckpointError: The run has no checkpoint.
        FileError: `resume=` names no run.
        InputError: The line starts a sweep, which cannot resume one run.
    """
    last: Callable[[Run], Path] = _checkpoint if command == "train" else lambda run: run.folder
    resumes = [argument for argument in arguments if argument.startswith(KEY)]
    path = _path(resumes[-1], KEY) if resumes else None
    if path is None:
        return arguments
    if path == AUTO:
        outputs = [argument for argument in arguments if argument.startswith(OUTPUT)]
        folder = _path(outputs[-1], OUTPUT) if outputs else None
        if folder is None:
            raise InputError("resume=auto goes on in output, which must be given", got="none", remedy="add output=RUN")
        if not _has_begun(Run(Path(folder)), last):
            return [argument for argument in arguments if argument not in resumes]
        path = folder
    if {"--multirun", "-m"} & set(arguments):
        remedy = "to go on with a sweep, give its command line again with output=SWEEP"
        raise InputError("resume goes on with one run, not with a sweep", remedy=remedy)
    run = Run.of(path)
    new = [argument for argument in arguments if argument not in resumes]
    replaced = {key_of(argument) for argument in new} | set(FOLDERS)
    known = [override for override in map(str, run.overrides) if key_of(override) not in replaced]
    old = [override for override in known if not _names_place(override, run)]
    if dropped := [override for override in known if override not in old]:
        print(f"{run.folder.name}: not taken over, give again what is to hold: {' '.join(dropped)}", file=sys.stderr)
    own = [] if "output" in {key_of(argument) for argument in new} else [f"output={quoted(run.folder)}"]
    return [*old, *own, *new, f"{KEY}{quoted(last(run))}"]


def _checkpoint(run: Run) -> Path:
    return run.chosen or run.last


def _has_begun(run: Run, last: Callable[[Run], Path]) -> bool:
    """Whether a folder holds a run that can go on."""
    try:
        last(run)
    except CheckpointError:
        return False
    return (run.folder / runs.OVERRIDES).is_file()


def _names_place(override: str, run: Run) -> bool:
    """Whether an override of a run folder says where files go, by its key or in a value such as {cache_folder: /x}.

    Raises:
        InputError: The text is no override but, for example, an option of the command line.
    """
    try:
        parsed = OverridesParser.create().parse_override(override)
        value = parsed.value()
    except HydraException as error:
        raise InputError(f"{run.folder / runs.OVERRIDES} must hold overrides KEY=VALUE", got=repr(override)) from error
    paths = [re.split(r"[./]", name) for name in (parsed.key_or_group, parsed.package) if name]
    return (
        any(path[0] in NOT_RESUMED for path in paths)
        or paths[-1][-1] in PLACES
        or any(key in PLACES for key in _keys(value))
    )


def _keys(node: Any) -> Iterator[str]:
    """All keys of nested dictionaries."""
    for item in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
        yield from _keys(item)
    yield from map(str, node if isinstance(node, dict) else ())


def _path(override: str, key: str) -> str | None:
    """The path as it was written, or as Hydra reads it if it is quoted; None for `null`."""
    text = override.removeprefix(key)
    if text[:1] in ("'", '"'):
        return str(OverridesParser.create().parse_override(override).value())
    return None if text == "null" else text


def quoted(text: str | Path) -> str:
    """A text or path as a quoted value, which Hydra does not interpret."""
    return "'" + re.sub(r"(\\*)'", r"\1\1\\'", str(text)) + "'"


def prepare(config: dict[str, Any], folder: Path) -> None:
    """Make a folder ready to continue: cut the log after the checkpoint, and copy the run's files to a new folder.

    Args:
        config: The resolved configuration, with the checkpoint in `resume`.
        folder: Folder in which training continues: the run's own, or a new one, which gets a copy of the run.

    Raises:
        CheckpointError: The checkpoint is damaged, or holds a network without the state of its training.
        InputError: The configuration would train something else.
    """
    run, checkpoint = Run.of(config["resume"]), Path(config["resume"])
    if not config["allow_changes"]:
        refuse_changes(run, config)
    # Lightning, of which only training has need, takes seconds and 200 MB to import.
    from lfref.train import modules

    step = runs.steps_done(checkpoint)
    if run.folder != folder:
        refuse_occupied(folder)
        for part in (runs.CHECKPOINTS, Path(runs.METRICS).parent, runs.PICTURES):
            if (run.folder / part).is_dir():
                shutil.copytree(run.folder / part, folder / part, dirs_exist_ok=True)
    modules.cut_log(folder / runs.METRICS, step)


def refuse_occupied(folder: Path) -> None:
    """Refuse to train over the checkpoints of another run.

    Raises:
        InputError: The folder holds checkpoints.
    """
    if Run(folder).has_checkpoints:
        raise InputError(
            "output must be a folder without a trained run",
            got=folder,
            remedy=f"go on with it by resume={folder}, or give another output",
        )


def refuse_changes(run: Run, config: dict[str, Any]) -> None:
    """Refuse to resume a run with other data, labels, planes, loss or network.

    Args:
        run: The run.
        config: The configuration of the resumed run.

    Raises:
        InputError: Some entries differ; the message names them.
    """
    refuse_other(run, config, PROTECTED, "leave it as it was, or give allow_changes=true", "what it was trained on")


def go_on(config: DictConfig, folder: Path) -> bool:
    """Refuse to resume a run with other settings or in another folder; a job of a sweep that is started again goes on.

    For commands that write one result after the other, each of them whole or not at all.
    """
    if is_sweep_job() and (folder / runs.OVERRIDES).is_file():
        config.resume = str(folder)
    if config.resume is not None:
        if not Run.of(config.resume).is_in(folder):
            expected, remedy = "results go on in the folder of the run", "leave output out"
            raise InputError(expected, got=f"output={folder}", remedy=remedy)
        plain = configs.plain(config)
        decisive = [key for key in plain if key not in (*FOLDERS, "overwrite", "device", "logger")]
        refuse_other(Run(folder), plain, decisive, "leave it as it was", "the settings that it began with")
    return True


def refuse_other(run: Run, config: dict[str, Any], keys: Iterable[str], remedy: str, what: str) -> None:
    """Refuse to resume a run with other values.

    Args:
        run: The run.
        config: The configuration of the resumed run.
        keys: Entries that must be the same.
        remedy: Remedy for the message.
        what: Description of the entries for the message.

    Raises:
        InputError: Some entries differ; the message names them.
    """
    kept = run.config
    known = [key for key in keys if key in kept]  # an older version of lfref may not have all keys
    found = [change for key in known for change in _changes(key, kept[key], config.get(key))]
    given = [name for name in _given_keys() if name.partition(".")[0] in known]
    found += [change for name in given for change in _added(name, kept, config)]
    # An interpolated value stands in several places: only the first one is named.
    named = {(name.rpartition(".")[2], values): f"{name} ({values})" for name, values in reversed(found)}
    if named:
        changes = list(reversed(named.values()))
        more = f" and {len(changes) - SHOWN} more" if len(changes) > SHOWN else ""
        got = ", ".join(changes[:SHOWN]) + more
        raise InputError(f"run {run.name} must go on with {what}", got=got, remedy=remedy)


def _changes(name: str, old: Any, new: Any) -> Iterator[tuple[str, str]]:
    """Name and values of each entry that differs; keys that only one version of lfref knows are left out."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in old.keys() & new.keys() - set(FREE):
            yield from _changes(f"{name}.{key}", old[key], new[key])
        if _kind(old) != _kind(new):
            yield f"{name}._target_", f"{_short(old)} -> {_short(new)}"
    elif old != new:
        yield name, f"{_short(old)} -> {_short(new)}"


def _given_keys() -> list[str]:
    """Keys that the command line sets, adds or deletes; those that it takes over from the run are among them."""
    if not HydraConfig.initialized():
        return []
    return [str(word).lstrip("+~").partition("=")[0] for word in HydraConfig.get().overrides.task]


def _added(name: str, old: Any, new: Any) -> Iterator[tuple[str, str]]:
    """Name and values of an entry that only one of two configurations has."""
    *path, last = name.split(".")
    for key in [*path, last]:
        old, new = (node.get(key) if isinstance(node, dict) else None for node in (old, new))
    if last not in FREE and (old is None) != (new is None):
        yield name, f"{_short(old)} -> {_short(new)}"


def _kind(node: dict[str, Any]) -> str:
    """Name of the class or function of a node, without its module, which differs between versions of lfref."""
    kind = str(node.get("_target_")).rpartition(".")[2]
    return "planes_at_alphas" if kind == "FocalPlanes" and "alphas" in node else kind


def _short(value: Any) -> str:
    return value.get("_target_", "other settings") if isinstance(value, dict) else str(value)


# Jobs of sweeps.

log = logging.getLogger("lfref")


def is_sweep_job() -> bool:
    """Whether this process runs a job of a sweep."""
    return HydraConfig.initialized() and HydraConfig.get().mode == RunMode.MULTIRUN


def record_failure(error: Exception) -> None:
    """Note in its folder that a job failed; it ends like any other, so that no launcher stops the rest."""
    hydra = HydraConfig.get()
    folder, reason = Path(hydra.runtime.output_dir), " ".join(str(error).split()) or type(error).__name__
    log.error("failed: %s: %s", folder, reason, exc_info=None if isinstance(error, LfrefError) else error)
    note = {"overrides": list(hydra.overrides.task), "reason": reason}
    atomic.write_text(folder / FAILURE, json.dumps(note, indent=1))


class FailedJobs(Callback):
    """At the end of a sweep, names the jobs that failed."""

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        """Remove the notes of an earlier run of the sweep."""
        for file in self._notes(config):
            file.unlink(missing_ok=True)

    def on_multirun_end(self, config: DictConfig, **_: Any) -> None:
        """Exit with status 1 if jobs failed, in whatever process they ran."""
        lines = []
        for file in self._notes(config):
            note = json.loads(file.read_text("utf-8"))
            own = " ".join(override for override in note["overrides"] if override not in sys.argv)
            lines.append(f"{file.parent} ({own}): {note['reason']}")
        if lines:
            count = f"{len(lines)} of the runs failed" if len(lines) > 1 else "one of the runs failed"
            print(f"lfref {config.hydra.job.name}: {count}:", *lines, sep="\n  ", file=sys.stderr)
            sys.exit(1)

    def _notes(self, config: DictConfig) -> list[Path]:
        return sorted(Path(config.hydra.sweep.dir).glob(f"*/{FAILURE}"))


def checkpoint_of(folder: Path, overrides: list[str]) -> Path | None:
    """The checkpoint from which an interrupted job continues; None: the job starts anew.

    Args:
        folder: Folder of the job.
        overrides: Overrides of the job.

    Raises:
        InputError: The folder holds another run.
    """
    if not Run(folder).has_checkpoints:
        return None
    if _decisive(Run(folder).overrides) != _decisive(overrides):
        raise InputError(
            "a sweep that is run again must have the same jobs in the same order",
            got=f"another run in {folder}: {' '.join(_decisive(Run(folder).overrides))}",
            remedy="give another output",
        )
    return Run(folder).last


def _decisive(overrides: list[str]) -> list[str]:
    return [override for override in overrides if key_of(override) not in FOLDERS]
