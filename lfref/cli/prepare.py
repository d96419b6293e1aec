"""`lfref prepare`: make a set of planes to learn from, once, by all processors, from where it was interrupted."""

import json
import os
from pathlib import Path

import torch
from omegaconf import DictConfig
from torch.utils.data import DataLoader, Dataset

from lfref.cli import config as configs
from lfref.cli.command import command, log, progress
from lfref.data import plane_sets
from lfref.data.plane_sets import Recipe
from lfref.io import atomic


class Making(Dataset[int]):
    """Makes and keeps the items that are asked for.

    Args:
        recipe: Of the set.
        folder: Where it lies.
        missing: Numbers of the items.
    """

    def __init__(self, recipe: Recipe, folder: Path, missing: list[int]) -> None:
        self.recipe = recipe
        self.folder = folder
        self.missing = missing

    def __len__(self) -> int:
        return len(self.missing)

    def __getitem__(self, place: int) -> int:
        index = self.missing[place]
        plane_sets.write(plane_sets.path_of(self.folder, index), plane_sets.make(self.recipe, index))
        return index


def prepare(config: DictConfig, folder: Path) -> None:
    """Make what is missing of a set in the cache, and note in the run folder where it lies.

    Args:
        config: `conf/prepare.yaml`.
        folder: The run folder.
    """
    recipe: Recipe = configs.build(config.recipe)
    n_fields = int(configs.number(config, "n_fields", 1))
    place = plane_sets.folder_of(recipe, Path(config.cache_folder).expanduser())
    told = json.dumps({"key": recipe.key(), **recipe.description()}, indent=1, default=str)
    for at in (place, folder):
        at.mkdir(parents=True, exist_ok=True)
        atomic.write_text(at / "set.json", told + "\n")
    missing = [index for index in range(n_fields) if not plane_sets.path_of(place, index).is_file()]
    log.info("%d of %d are there", n_fields - len(missing), n_fields)
    making = Making(recipe, place, missing)
    made = DataLoader(making, batch_size=None, num_workers=_workers(config), worker_init_fn=_alone)
    for _ in progress(made, "making planes"):
        pass
    log.info("planes of %d light fields in %s", n_fields, place)


def _workers(config: DictConfig) -> int:
    if config.workers == "auto":
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return int(configs.number(config, "workers", 0))


def _alone(worker: int) -> None:
    torch.set_num_threads(1)


main = command(prepare)
