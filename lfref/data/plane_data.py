"""Lightning data module for prepared sets of planes: random crops to train on, whole planes to validate.

Letters: `B` planes of a batch, `K` channels of features, `C H W` channel, pixel row and column.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TypedDict

import numpy as np
import torch
from lightning.pytorch import LightningDataModule
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from lfref.data import plane_sets
from lfref.data.patch_data import epoch_loader
from lfref.data.plane_sets import Recipe
from lfref.errors import InputError, counted


class PlaneBatch(TypedDict):
    """Crops of planes."""

    features: Tensor
    """[B, K, H, W]."""
    pictures: Tensor
    """Classical pictures that the refiner corrects, [B, C, H, W]."""
    error_scale: Tensor
    """Expected error of the pictures, [B, 1, H, W]."""
    missing: Tensor
    """Truth minus pictures, [B, C, H, W]."""
    where: list[str]
    """Names of the item's file and its plane, B entries."""
    resampled: int
    """Always 0: crops of planes are never drawn again. Patches of light fields are."""


class Crops(Dataset[PlaneBatch]):
    """Random crops in random orientations, one plane per entry, repeatable by (seed, epoch, place).

    Planes of one light field have similar errors, so a batch mixes planes of many light fields. All items must have the
    same number of planes.
    """

    def __init__(self, paths: Sequence[Path], crop: int, seed: int) -> None:
        self.paths = paths
        self.crop = crop
        self.seed = seed
        self.n_planes, *self.size = plane_sets.shape(paths[0])
        if crop > min(self.size):
            size = "x".join(map(str, self.size))
            raise InputError(f"crops must be at most as large as the planes, {size}", got=crop)

    def __len__(self) -> int:
        return len(self.paths) * self.n_planes

    def __getitem__(self, key: tuple[int, int]) -> PlaneBatch:
        epoch, place = key
        path, plane = self.paths[place // self.n_planes], place % self.n_planes
        random = np.random.default_rng((self.seed, epoch, place))
        firsts = (int(random.integers(length - self.crop + 1)) for length in self.size)
        box = (slice(first, first + self.crop) for first in firsts)
        parts = plane_sets.read(path, slice(plane, plane + 1), *box)[:-1]
        images = turned(torch.cat(parts, 1).float(), random)
        return _batch(images.split([part.shape[1] for part in parts], 1), [f"{path.name}, plane {plane}"])


class Wholes(Dataset[PlaneBatch]):
    """All planes of an item, not cropped."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self.paths = paths

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, key: tuple[int, int]) -> PlaneBatch:
        path = self.paths[key[1]]
        parts = [part.float() for part in plane_sets.read(path)[:-1]]
        return _batch(parts, [f"{path.name}, plane {plane}" for plane in range(len(parts[0]))])


def _batch(parts: Sequence[Tensor], where: list[str]) -> PlaneBatch:
    features, pictures, error_scale, missing = parts
    images = {"features": features, "pictures": pictures, "error_scale": error_scale, "missing": missing}
    return PlaneBatch(**images, where=where, resampled=0)  # type: ignore[typeddict-item]


def turned(image: Tensor, random: np.random.Generator) -> Tensor:
    """Square images in a random one of eight orientations, on which no feature depends."""
    down, across, over = (bool(draw) for draw in random.integers(2, size=3))
    image = image.flip([axis for axis, is_flipped in ((-2, down), (-1, across)) if is_flipped])
    return image.mT if over else image


def together(items: Sequence[PlaneBatch]) -> PlaneBatch:
    """The planes of several items as one batch."""
    names = ("features", "pictures", "error_scale", "missing")
    parts = [torch.cat([item[name] for item in items]) for name in names]  # type: ignore[literal-required]
    return _batch(parts, [place for item in items for place in item["where"]])


class PlaneData(LightningDataModule):
    """Crops of the planes that `lfref prepare` wrote.

    Args:
        recipe: Recipe of the set.
        cache_folder: Folder of all sets.
        folder: Folder of the set; None: the recipe's folder in the cache.
        n_fields: Number of light fields to use, the first ones of the set; None: all.
        n_validation: Number of held-out light fields, the first ones.
        crop: Height and width of training crops in pixels.
        planes_per_batch: Crops per batch, from any light fields.
        workers: Processes that prepare batches; 0 prepares them in the training process.
        seed: Seed of order and crops.
    """

    def __init__(
        self,
        recipe: Recipe,
        cache_folder: str,
        folder: str | None = None,
        n_fields: int | None = None,
        n_validation: int = 40,
        crop: int = 96,
        planes_per_batch: int = 24,
        workers: int = 0,
        seed: int = 0,
    ) -> None:
        super().__init__()
        if min(n_validation, crop, planes_per_batch) < 1 or min(workers, seed) < 0:
            got = f"{n_validation}, {crop}, {planes_per_batch}, {workers} and {seed}"
            raise InputError("n_validation, crop and planes_per_batch must be at least 1, workers and seed 0", got=got)
        self.folder = plane_sets.folder_of(recipe, Path(cache_folder).expanduser()) if folder is None else Path(folder)
        self.n_fields = n_fields
        self.n_validation = n_validation
        self.crop = crop
        self.planes_per_batch = planes_per_batch
        self.workers = workers
        self.seed = seed

    def setup(self, stage: str) -> None:
        """List the items; Lightning calls this in every process."""
        paths = sorted(self.folder.glob(f"*{plane_sets.SUFFIX}"))[: self.n_fields]
        if len(paths) <= self.n_validation or (self.n_fields or 0) > len(paths):
            raise InputError(
                f"{self.folder} must hold {counted(self.n_fields or self.n_validation + 1, 'light field')}",
                got=len(paths),
                remedy="make them by lfref prepare with the same recipe",
            )
        self.held, self.trained = paths[: self.n_validation], paths[self.n_validation :]

    def train_dataloader(self) -> DataLoader[PlaneBatch]:
        """Crops in a new order and at new places each epoch."""
        crops = Crops(self.trained, self.crop, self.seed)
        return epoch_loader(self, crops, self.seed, self.planes_per_batch, together, self.workers)

    def val_dataloader(self) -> DataLoader[PlaneBatch]:
        """The planes of each held-out item as a whole."""
        return epoch_loader(self, Wholes(self.held), None, 1, together, self.workers)
