"""`lfref prepare`: make a set of planes for training, on all processors; items that exist are kept."""

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
from lfref.errors import counted
from lfref.io import atomic


class MissingItems(Dataset[int]):
    """Missing items of a set, which the workers of a data loader make and write."""

    def __init__(self, recipe: Recipe, folder: Path, missing: list[int]) -> None:
        self.recipe, self.folder, self.missing = recipe, folder, missing

    def __len__(self) -> int:
        return len(self.missing)

    def __getitem__(self, position: int) -> int:
        index = self.missing[position]
        plane_sets.write(plane_sets.path_of(self.folder, index), plane_sets.make(self.recipe, index))
        return index


def prepare(config: DictConfig, folder: Path) -> None:
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
    if config.workers == "auto":
        n_workers = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    else:
        n_workers = int(configs.number(config, "workers", 0))
    items = MissingItems(recipe, place, missing)
    for _ in progress(
        DataLoader(items, batch_size=None, num_workers=n_workers, worker_init_fn=_one_thread), "making planes"
    ):
        pass
    log.info("planes of %s in %s", counted(n_fields, "light field"), place)


def _one_thread(worker: int) -> None:
    torch.set_num_threads(1)


main = command(prepare)
