"""Crops of a set of planes, for Lightning.

Letters: `B` planes of a batch, `K` channels of guides, `C H W` channel, pixel row and column.
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
from lfref.data.patches import EpochSampler
from lfref.data.plane_sets import Recipe
from lfref.errors import InputError


class PlaneBatch(TypedDict):
    """Crops of planes."""

    guides: Tensor
    """[B, K, H, W]."""
    pictures: Tensor
    """What is to be corrected, [B, C, H, W]."""
    doubts: Tensor
    """How far the pictures may be off, [B, 1, H, W]."""
    missing: Tensor
    """What a lens would have recorded less the pictures, [B, C, H, W]."""
    where: list[str]
    """Number of the item and of its plane, B entries."""
    resampled: int
    """Crops that were drawn again; none ever is."""


class Crops(Dataset[PlaneBatch]):
    """The planes of an item: crops, mirrored and turned at random, the same for the same (seed, epoch, item).

    Args:
        paths: The items.
        crop: Height and width in pixels; None takes planes as they are.
        seed: Of the crops.
    """

    def __init__(self, paths: Sequence[Path], crop: int | None, seed: int) -> None:
        self.paths = paths
        self.crop = crop
        self.seed = seed

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, key: tuple[int, int]) -> PlaneBatch:
        epoch, index = key
        path = self.paths[index]
        item = plane_sets.read(path)
        random = np.random.default_rng((self.seed, epoch, index))
        parts = item[:-1]
        images = torch.cat(parts, 1)
        if self.crop is not None:
            images = torch.stack([turned(cropped(plane, self.crop, random), random) for plane in images])
        guides, pictures, doubts, missing = images.float().split([part.shape[1] for part in parts], 1)
        where = [f"{path.name}, plane {plane}" for plane in range(len(images))]
        return PlaneBatch(
            guides=guides,
            pictures=pictures,
            doubts=doubts,
            missing=missing,
            where=where,
            resampled=0,
        )


def cropped(image: Tensor, crop: int, random: np.random.Generator) -> Tensor:
    """A square of an image [K, H, W] somewhere within, [K, crop, crop].

    Raises:
        InputError: It is smaller.
    """
    height, width = image.shape[-2:]
    if crop > min(height, width):
        raise InputError(f"crops must be at most as large as the planes, {height}x{width}", got=crop)
    top, left = (int(random.integers(length - crop + 1)) for length in (height, width))
    return image[..., top : top + crop, left : left + crop]


def turned(image: Tensor, random: np.random.Generator) -> Tensor:
    """A square image in one of its eight orientations: no guide knows left from right, nor across from down."""
    down, across, over = (bool(draw) for draw in random.integers(2, size=3))
    image = image.flip([axis for axis, is_flipped in ((-2, down), (-1, across)) if is_flipped])
    return image.mT if over else image


def together(items: Sequence[PlaneBatch]) -> PlaneBatch:
    """The planes of several items as one batch."""
    guides, pictures, doubts, missing = (
        torch.cat([item[name] for item in items]) for name in ("guides", "pictures", "doubts", "missing")
    )
    where = [place for item in items for place in item["where"]]
    return PlaneBatch(
        guides=guides,
        pictures=pictures,
        doubts=doubts,
        missing=missing,
        where=where,
        resampled=0,
    )


class PlaneData(LightningDataModule):
    """Crops of the planes that `lfref prepare` made.

    Args:
        recipe: Of the set.
        cache_folder: Where sets are kept.
        folder: Where the set lies; None looks in the cache.
        n_fields: Light fields to use, the first ones of the set; None takes all there are.
        n_validation: The first ones of these are held out.
        crop: Height and width of what is trained on, in pixels.
        fields_per_batch: Light fields whose planes make a batch.
        workers: Processes that prepare batches; 0 prepares them in the training process.
        seed: Of order and crops.

    Raises:
        InputError: A number that is too small.
    """

    def __init__(
        self,
        recipe: Recipe,
        cache_folder: str,
        folder: str | None = None,
        n_fields: int | None = None,
        n_validation: int = 40,
        crop: int = 96,
        fields_per_batch: int = 4,
        workers: int = 0,
        seed: int = 0,
    ) -> None:
        super().__init__()
        if min(n_validation, crop, fields_per_batch) < 1 or min(workers, seed) < 0:
            got = f"{n_validation}, {crop}, {fields_per_batch}, {workers} and {seed}"
            raise InputError("n_validation, crop and fields_per_batch must be at least 1, workers and seed 0", got=got)
        self.folder = plane_sets.folder_of(recipe, Path(cache_folder).expanduser()) if folder is None else Path(folder)
        self.n_fields = n_fields
        self.n_validation = n_validation
        self.crop = crop
        self.fields_per_batch = fields_per_batch
        self.workers = workers
        self.seed = seed

    def setup(self, stage: str) -> None:
        """Find the items; Lightning calls this in every process.

        Raises:
            InputError: There are too few.
        """
        paths = sorted(self.folder.glob(f"*{plane_sets.SUFFIX}"))[: self.n_fields]
        if len(paths) <= self.n_validation or (self.n_fields or 0) > len(paths):
            raise InputError(
                f"{self.folder} must hold {self.n_fields or self.n_validation + 1} light fields",
                got=len(paths),
                remedy="make them by lfref prepare with the same recipe",
            )
        self.held, self.trained = paths[: self.n_validation], paths[self.n_validation :]

    def train_dataloader(self) -> DataLoader[PlaneBatch]:
        """Crops in a new order and at new places each epoch."""
        return self._loader(Crops(self.trained, self.crop, self.seed), self.seed, self.fields_per_batch)

    def val_dataloader(self) -> DataLoader[PlaneBatch]:
        """The planes of each held-out item as a whole."""
        return self._loader(Crops(self.held, None, self.seed), None, 1)

    def _loader(self, crops: Crops, order_seed: int | None, n_fields: int) -> DataLoader[PlaneBatch]:
        rank, world_size = (self.trainer.global_rank, self.trainer.world_size) if self.trainer else (0, 1)
        return DataLoader(
            crops,
            batch_size=n_fields,
            sampler=EpochSampler(len(crops), order_seed, rank, world_size),
            collate_fn=together,
            num_workers=self.workers,
            persistent_workers=self.workers > 0,
            pin_memory=bool(self.trainer and self.trainer.accelerator.name() == "cuda"),
        )
