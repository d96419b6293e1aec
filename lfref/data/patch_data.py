"""Random patches of light fields with their labels, repeatable by (seed, epoch, index).

One item is one light field. Its patches are cut together, so that a field is read or rendered once per epoch. A flat
patch is drawn again: a network learns nothing from it, and normalisation would divide by nearly 0.
"""

import math
import signal
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypedDict

import numpy as np
import torch
from lightning.pytorch import LightningDataModule
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler
from torch.utils.data._utils import signal_handling

from lfref.data.field_sources import Field, Source
from lfref.data.label_sources import Labels
from lfref.errors import InputError, counted

FLAT = 1 / 255
"""Least difference between the brightest and the darkest sample of a patch's views: one 8-bit level."""
DRAWS = 8
"""Number of draws of a corner after which a flat patch is left out."""


class Batch(TypedDict):
    """Patches of one or more light fields."""

    views: Tensor
    """Views of the patches in [0, 1], [P, V, U, C, H, W]."""
    labels: Tensor
    """Labels of the patches, [P, N, C, H, W]."""
    slopes: Tensor
    """Slopes of the labels' planes, in pixels per view step, float64, [N]."""
    where: list[str]
    """Light field and top left corner of each patch, P entries."""
    resampled: int
    """Number of flat patches that were drawn again."""


def cut(field: Field, labels: Labels, top: int, left: int, patch: int) -> tuple[Tensor, Tensor] | None:
    """Views [V, U, C, patch, patch] and label [N, C, patch, patch] of one patch; None if the views are flat.

    The label is computed with the margin that it depends on.
    """
    margin = labels.margin(field.grid)
    # The patch with its margin, inside the field and wide enough for the largest shift.
    least, crop, inner = 2 * margin + 1, [], []
    for start, length in zip((top, left), field.size, strict=True):
        first = max(0, min(start - margin, length - least))
        last = min(length, max(start + patch + margin, first + least))
        crop.append((first, last - first))
        inner.append(slice(start - first, start - first + patch))
    (row, height), (column, width) = crop
    window = (..., inner[0], inner[1])
    context = field.crop(row, column, height, width)
    views = context.views[window].contiguous()
    darkest, brightest = views.aminmax()
    if brightest - darkest < FLAT:  # False for NaN: training reports samples that are not finite.
        return None
    return views, labels(context)[window].contiguous()


class FieldPatches(Dataset[Batch]):
    """Random patches of every light field of a source; `seed` fixes the corners."""

    def __init__(self, source: Source, labels: Labels, patch: int, patches_per_field: int, seed: int) -> None:
        if min(patch, patches_per_field) < 1:
            raise InputError("patch and patches_per_field must be at least 1", got=(patch, patches_per_field))
        self.source = source
        self.labels = labels
        self.patch = patch
        self.patches_per_field = patches_per_field
        self.seed = seed

    def __len__(self) -> int:
        return len(self.source)

    def __getitem__(self, key: tuple[int, int]) -> Batch:
        epoch, index = key
        # A field without a patch is replaced by the next one, so that every rank takes as many steps.
        for step in range(len(self)):
            if batch := self._of_field(epoch, (index + step) % len(self)):
                return batch
        raise InputError(
            "light fields must have patches that are not flat",
            got=f"none in {counted(len(self), 'light field')}",
            remedy="give other fields, or set data.patch larger",
        )

    def _of_field(self, epoch: int, index: int) -> Batch | None:
        """The patches of one field; None if all drawn patches are flat."""
        field = self.source.field(index, epoch)
        if min(field.size) < self.patch:
            raise InputError(
                f"light field {field.name} must be at least {self.patch} pixels in both directions",
                got=f"{field.size[0]}x{field.size[1]}",
                remedy="set data.patch smaller",
            )
        random = np.random.default_rng((self.seed, epoch, index))
        draws = [draw for _ in range(self.patches_per_field) for draw in self._draw(field, random)]
        patches = [(where, *pair) for where, pair in draws if pair is not None]
        if not patches:
            return None
        where, views, stacks = zip(*patches, strict=True)
        return {
            "views": torch.stack(views),
            "labels": torch.stack(stacks),
            "slopes": self.labels.planes.slopes,
            "where": list(where),
            "resampled": len(draws) - len(patches),
        }

    def _draw(self, field: Field, random: np.random.Generator) -> Iterator[tuple[str, tuple[Tensor, Tensor] | None]]:
        """(NAME@TOP,LEFT, patch) of random corners, up to the first patch that is not flat; a flat patch is None."""
        free = np.array(field.size) - self.patch
        for _ in range(DRAWS):
            top, left = random.integers(0, free + 1).tolist()
            pair = cut(field, self.labels, top, left, self.patch)
            yield f"{field.name}@{top},{left}", pair
            if pair is not None:
                return


class EpochSampler(Sampler[tuple[int, int]]):
    """Yields (epoch, index), shuffled by (seed, epoch) and divided among the ranks of a distributed run.

    The key holds the epoch, so that persistent workers get it, and a resumed run draws the patches of an uninterrupted
    one. Without a seed (validation), the order is fixed and the epoch stays 0.
    """

    def __init__(self, n_items: int, seed: int | None, rank: int = 0, world_size: int = 1) -> None:
        self.n_items = n_items
        self.seed = seed
        self.rank = rank
        self.world_size = world_size
        self.epoch = 0
        self.skip = 0
        """Items of the next epoch that a resumed training has already processed."""

    def set_epoch(self, epoch: int) -> None:
        """Set the next epoch; Lightning calls this."""
        self.epoch = epoch

    def __len__(self) -> int:
        return len(self._order())

    def __iter__(self) -> Iterator[tuple[int, int]]:
        epoch = 0 if self.seed is None else self.epoch
        order, self.skip = self._order()[self.skip :], 0
        return ((epoch, index) for index in order)

    def _order(self) -> list[int]:
        if self.seed is None:
            # A rank without an item would block the other ranks: it repeats an item.
            return list(range(self.rank, self.n_items, self.world_size)) or [self.rank % self.n_items]
        order = np.random.default_rng((self.seed, self.epoch)).permutation(self.n_items).tolist()
        # All ranks must take equally many steps: wrap around to an even share.
        share = math.ceil(self.n_items / self.world_size)
        return [order[i % self.n_items] for i in range(self.rank, share * self.world_size, self.world_size)]


def concatenate(items: Sequence[Batch]) -> Batch:
    """Join the patches of several light fields into one batch."""
    return {
        "views": torch.cat([item["views"] for item in items]),
        "labels": torch.cat([item["labels"] for item in items]),
        "slopes": items[0]["slopes"],
        "where": [place for item in items for place in item["where"]],
        "resampled": sum(item["resampled"] for item in items),
    }


class EpochLoader(DataLoader[Any]):
    """A loader whose workers start at the first batch.

    Lightning makes the iterator of a resumed training before it sets the epoch: workers that start with the iterator
    would prepare the data of epoch 0. Lightning also removes PyTorch's handler of SIGCHLD after a training: without it,
    the next training of the process notices a dead worker only after the timeout.
    """

    def __iter__(self) -> Iterator[Any]:  # type: ignore[override]
        if self.num_workers and signal.getsignal(signal.SIGCHLD) == signal.SIG_DFL:
            signal_handling._SIGCHLD_handler_set = False
        yield from super().__iter__()

    def state_dict(self) -> dict[str, Any]:
        """An empty state: the trainer tells `epoch_loader` where to continue. Lightning warns without this method."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Ignore the state, which is empty."""


def epoch_loader(
    module: LightningDataModule,
    items: Any,
    order_seed: int | None,
    batch_size: int,
    collate: Callable[[Sequence[Any]], Any],
    workers: int,
    timeout: float = 0.0,
) -> DataLoader[Any]:
    """Batches of a data module, ordered by an `EpochSampler`; `timeout` is in seconds per batch (0: no limit)."""
    trainer = module.trainer
    rank, world_size = (trainer.global_rank, trainer.world_size) if trainer else (0, 1)
    sampler = EpochSampler(len(items), order_seed, rank, world_size)
    if trainer and order_seed is not None and trainer.fit_loop.restarting:
        # The checkpoint may have been written in the middle of an epoch, when a signal came.
        epochs: Any = trainer.fit_loop.epoch_progress.total
        batches: Any = trainer.fit_loop.epoch_loop.batch_progress
        if epochs.processed < epochs.started and not batches.is_last_batch:
            sampler.skip = batches.current.processed * batch_size
    return EpochLoader(
        items,
        batch_size=batch_size,
        sampler=sampler,
        collate_fn=collate,
        num_workers=workers,
        persistent_workers=workers > 0,
        timeout=timeout if workers else 0,
        pin_memory=bool(trainer and trainer.accelerator.name() == "cuda"),
    )
