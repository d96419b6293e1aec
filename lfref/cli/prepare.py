"""`lfref prepare`: make a set for training, on all processors; what exists is kept.

`set=planes` draws planes of simulated scenes, `set=captures` decodes light fields into tiles.
"""

import functools
import json
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from omegaconf import DictConfig
from torch.utils.data import DataLoader, Dataset

from lfref.cli import config as configs
from lfref.cli import steps
from lfref.cli.command import command, log, progress
from lfref.data import plane_sets, prepared
from lfref.data.cache import Reading
from lfref.data.plane_sets import Recipe
from lfref.data.stored_fields import SUFFIX
from lfref.errors import FileError, InputError, LfrefError, chosen, counted
from lfref.io import atomic

ROOM = 1.02
"""Space that a set needs on its disk, as a multiple of its estimate."""


class Jobs(Dataset[str | None]):
    """Jobs that the workers of a data loader do; the item of each is the error that it ended with, or None."""

    def __init__(self, jobs: Sequence[Callable[[], object]]) -> None:
        self.jobs = jobs

    def __len__(self) -> int:
        return len(self.jobs)

    def __getitem__(self, position: int) -> str | None:
        try:
            self.jobs[position]()
        except LfrefError as error:
            return str(error)
        return None


def do(jobs: Sequence[Callable[[], object]], config: DictConfig, what: str) -> list[str]:
    """Do jobs in as many processes as the configuration says; returns the errors."""
    loader = DataLoader(Jobs(jobs), batch_size=None, num_workers=number_of_workers(config), worker_init_fn=_one_thread)
    return [error for error in progress(loader, what) if error is not None]


def number_of_workers(config: DictConfig) -> int:
    """Processes that do jobs; 0: this one."""
    if config.workers == "auto":
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return int(configs.number(config, "workers", 0))


def _one_thread(worker: int) -> None:
    torch.set_num_threads(1)


def planes(config: DictConfig, folder: Path) -> None:
    """Make the missing items of a set in the cache, and write its key and description into the run folder."""
    recipe: Recipe = configs.build(config.recipe)
    n_fields = int(configs.number(config, "n_fields", 1))
    place = plane_sets.folder_of(recipe, Path(config.cache_folder).expanduser())
    description = json.dumps({"key": recipe.key(), **recipe.description()}, indent=1, default=str)
    for target in (place, folder):
        target.mkdir(parents=True, exist_ok=True)
        atomic.write_text(target / "set.json", description + "\n")
    missing = [index for index in range(n_fields) if not plane_sets.path_of(place, index).is_file()]
    log.info("%d of %d exist", n_fields - len(missing), n_fields)
    jobs = [functools.partial(plane_sets.prepare, recipe, place, index) for index in missing]
    if errors := do(jobs, config, "making planes"):
        raise LfrefError("all items must be made", got=errors[0], remedy="the others are done")
    log.info("planes of %s in %s", counted(n_fields, "light field"), place)


def captures(config: DictConfig, folder: Path) -> None:
    """Decode light fields into the folder of a set, and list the set in the run folder too."""
    reading = Reading(configs.plain(config.reader), str(config.correct))
    place = Path(config.set_folder).expanduser()
    if place.exists() and not prepared.is_set(place) and (not place.is_dir() or any(place.iterdir())):
        expected = "set_folder must be a new or an empty folder, or a set"
        raise FileError(expected, got=str(place), remedy="choose another folder")
    sources = steps.find_fields(config)
    splits = {} if config.splits is None else prepared.read_splits(Path(config.splits))
    known = {entry.name: entry for entry in prepared.readable(place)}
    prepared.refuse_mixed(known.values(), reading)
    # A part that is not given stays as it was, also where a light field is decoded again.
    parts = {
        name: part or (known[name].split if name in known else None)
        for name, part in prepared.split_of(sources, splits).items()
    }
    paths = {name: place / f"{name}{SUFFIX}" for name in sources}
    damaged = prepared.check(place) if config.check and prepared.is_set(place) else {}
    for error in damaged.values():
        log.warning("damaged: %s", error)
    missing = [
        name
        for name in sources
        if paths[name].name in damaged or not prepared.is_done(paths[name], sources[name], reading, parts[name])
    ]
    log.info("%d of %d exist in %s", len(sources) - len(missing), len(sources), place)
    jobs = [functools.partial(prepared.prepare, paths[name], sources[name], reading, parts[name]) for name in missing]
    errors = []
    if jobs:
        prepared.forget_manifest(place)
        # The first ones, one for each process, tell how large the set becomes.
        n_first = max(1, number_of_workers(config))
        errors += do(jobs[:n_first], config, "decoding the first light fields")
        _check_room(config, place, len(known.keys() | sources.keys()))
        errors += do(jobs[n_first:], config, "decoding light fields")
    if prepared.is_set(place):
        entries = prepared.write_manifest(place)
        shutil.copyfile(place / prepared.MANIFEST, folder / prepared.MANIFEST)
        total = f"{counted(len(entries), 'light field')} of {sum(entry.n_bytes for entry in entries) / 1e9:.3g} GB"
        log.info("%s in %s: lfref train data=folder data.path=%s", total, place, place)
    if errors:
        got = f"{len(errors)} that cannot: {'; '.join(errors)}"
        raise LfrefError(f"all {len(sources)} light fields must be usable", got=got, remedy="the others are done")


def _check_room(config: DictConfig, place: Path, n_fields: int) -> None:
    """Say how large a set of so many light fields becomes, and refuse it if that is too large."""
    sizes = [entry.n_bytes for entry in prepared.manifest(place)] if prepared.is_set(place) else []
    if not sizes:
        return
    mean = sum(sizes) / len(sizes)
    total, left = mean * n_fields, mean * (n_fields - len(sizes))
    log.info("%.3g MB a light field: %.3g GB in all", mean / 1e6, total / 1e9)
    if config.most_gb is not None and total > 1e9 * configs.number(config, "most_gb", 0):
        remedy = "raise it, or keep fewer views or pixels by reader.views or reader.size"
        raise InputError(
            f"the set must stay below most_gb={config.most_gb}", got=f"{total / 1e9:.3g} GB", remedy=remedy
        )
    if left * ROOM > (free := shutil.disk_usage(place).free):
        remedy = "choose another disk, or keep fewer views or pixels by reader.views or reader.size"
        expected, got = f"{place} must have room for {left / 1e9:.3g} GB", f"{free / 1e9:.3g} GB free"
        raise FileError(expected, got=got, remedy=remedy)


SETS: dict[str, Callable[[DictConfig, Path], None]] = {"planes": planes, "captures": captures}
"""Name of a set's kind -> its function; its options are in `conf/set/NAME.yaml`."""


def prepare(config: DictConfig, folder: Path) -> None:
    """Make a set of one kind."""
    chosen("set", config.set, SETS)(config, folder)


run = command(prepare)
