"""Random crops of light fields, repeatable by (seed, epoch, place), and their order in an epoch.

A crop is a patch with the margin that its label depends on. Crops near the border move inwards, so that all have one
shape, and PyTorch's default collate stacks them. A flat patch is drawn again: a network learns nothing from it, and
normalisation would divide by nearly 0. Batches are decoded and get their labels on the device of the network.
"""

import abc
import math
import signal
from collections.abc import Callable, Iterator
from typing import Any, NotRequired, TypedDict

import numpy as np
import torch
from lightning.pytorch import LightningDataModule
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler, default_collate

from lfref import encoding as encodings
from lfref.data.cache import Field
from lfref.data.labels import OperatorLabels, RenderedLabels
from lfref.encoding import LINEAR
from lfref.errors import InputError
from lfref.lightfield import LightField

FLAT = 1 / 255
"""Least difference between the brightest and the darkest sample of a patch's views: one 8-bit level."""
DRAWS = 8
"""Number of draws of a corner after which a flat patch is left out."""
MOST_WORKERS = 8


class Crop(TypedDict):
    """A patch and its margin, as stored."""

    samples: Tensor  # [V, U, C, h, w]
    weight: NotRequired[Tensor]  # [V, U, 1, h, w]
    encoding: str
    window: Tensor  # first row and column of the patch in the crop, [2]
    where: str  # light field and top left corner of the patch, NAME@TOP,LEFT
    labels: NotRequired[Tensor]  # rendered labels of the patch, [N, C, p, p]


class Batch(TypedDict):
    """Patches of one or more light fields, on the device of the network."""

    views: Tensor  # in [0, 1], [P, V, U, C, p, p]
    labels: Tensor  # [P, N, C, p, p]
    slopes: Tensor  # of the labels' planes, in pixels per view step, float64, [N]
    where: list[str]  # light field and top left corner of each patch, P entries


class Source(abc.ABC):
    """Light fields, repeatable by (index, epoch)."""

    @abc.abstractmethod
    def __len__(self) -> int:
        """Number of light fields per epoch."""

    @abc.abstractmethod
    def field(self, index: int, epoch: int = 0) -> Field | LightField:
        """The light field at a place in the epoch."""


class Crops(Dataset[Crop]):
    """Crops of every light field of a source, by (epoch, index of the field, number of the crop).

    `patch` is the side of a patch, `margin` a function of the grid -> pixels around it (None: 0), both in pixels.
    """

    def __init__(self, source: Source, patch: int, margin: Callable[[tuple[int, int]], int] | None, seed: int) -> None:
        self.source, self.patch, self.margin, self.seed = source, patch, margin, seed
        self._last: tuple[tuple[int, int], Field] | None = None

    def __getitem__(self, key: tuple[int, int, int]) -> Crop:
        epoch, index, number = key
        # A field without a patch is replaced by the next one, so that every rank takes as many steps.
        for step in range(len(self.source)):
            field = self._field((index + step) % len(self.source), epoch)
            random = np.random.default_rng((self.seed, epoch, index, number))
            if (crop := self._drawn(field, random)) is not None:
                return crop
        raise InputError("light fields must have patches that are not flat", got="none", remedy="look at data.path")

    def _field(self, index: int, epoch: int) -> Field:
        """The field at a place; the last one stays, since its crops follow each other."""
        if self._last is None or self._last[0] != (index, epoch):
            field = self.source.field(index, epoch)
            if isinstance(field, LightField):
                encoding = LINEAR if field.is_linear else encodings.parsed("none")
                field = Field(field.name, field.views.detach().float(), field.weight, encoding)
            self._last = (index, epoch), field
        return self._last[1]

    def _drawn(self, field: Field, random: np.random.Generator) -> Crop | None:
        """A crop at a random place; None if all that are drawn are flat."""
        size = field.samples.shape[-2:]
        free = np.array(size) - self.patch
        if free.min() < 0:
            got, remedy = "x".join(map(str, size)), "set data.patch smaller"
            raise InputError(f"{field.name} must be at least {self.patch} pixels high and wide", got=got, remedy=remedy)
        for _ in range(DRAWS):
            top, left = random.integers(0, free + 1).tolist()
            rows, columns = slice(top, top + self.patch), slice(left, left + self.patch)
            ends = torch.stack(field.samples[..., rows, columns].float().aminmax())
            if field.samples.dtype in (torch.uint8, torch.uint16):
                ends = ends / torch.iinfo(field.samples.dtype).max
            light = field.encoding.decode(ends)
            if not bool(light[1] - light[0] < FLAT):
                return self.cut(field, top, left)
        return None

    def cut(self, field: Field, top: int, left: int) -> Crop:
        """The crop of the patch at a corner."""
        n_rows, n_columns, _, *size = field.samples.shape
        margin = 0 if self.margin is None else self.margin((n_rows, n_columns))
        side = [min(length, self.patch + 2 * margin) for length in size]
        first = [
            min(max(0, start - margin), length - own)
            for start, own, length in zip((top, left), side, size, strict=True)
        ]
        rows, columns = (slice(start, start + own) for start, own in zip(first, side, strict=True))
        crop = Crop(
            samples=field.samples[..., rows, columns].clone(),
            encoding=str(field.encoding),
            window=torch.tensor([top - first[0], left - first[1]]),
            where=f"{field.name}@{top},{left}",
        )
        if field.weight is not None:
            crop["weight"] = field.weight[..., rows, columns].clone()
        if field.truth is not None:
            crop["labels"] = field.truth[..., top : top + self.patch, left : left + self.patch].float()
        return crop


def collated(crops: list[Crop]) -> dict[str, Any]:
    """A batch of crops; where only some have a weight, the others get ones."""
    weight = next((crop["weight"] for crop in crops if "weight" in crop), None)
    if weight is not None:
        full = 1 if weight.is_floating_point() else torch.iinfo(weight.dtype).max
        for crop in crops:
            crop.setdefault("weight", torch.full_like(weight, full))
    return dict(default_collate(crops))


def labelled(batch: dict[str, Any], labels: OperatorLabels | RenderedLabels, patch: int) -> Batch:
    """Decode the crops of a batch, and make their labels, on the device of the samples."""
    views, stacks = [], []
    for number, where in enumerate(batch["where"]):
        rows, columns = (slice(start, start + patch) for start in batch["window"][number].tolist())
        weight = batch["weight"][number] if "weight" in batch else None
        field = Field(where, batch["samples"][number], weight, encodings.parsed(batch["encoding"][number]))
        light = field.light()
        views.append(light.views[..., rows, columns])
        if not isinstance(labels, RenderedLabels):
            stacks.append(labels(light)[..., rows, columns])
    return {
        "views": torch.stack(views),
        "labels": torch.stack(stacks) if stacks else batch["labels"],
        "slopes": labels.planes.slopes,
        "where": batch["where"],
    }


class EpochSampler(Sampler[tuple[int, ...]]):
    """Yields (epoch, index, number): items shuffled by (seed, epoch) and shared among the ranks, each several times.

    Persistent workers, and resumed runs, thereby know the epoch. Without a seed (validation) all epochs are alike.
    """

    def __init__(self, n_items: int, seed: int | None, repeats: int = 1, rank: int = 0, world_size: int = 1) -> None:
        self.n_items, self.seed, self.repeats, self.rank, self.world_size = n_items, seed, repeats, rank, world_size
        self.epoch = 0
        self.skip = 0
        """Keys of the next epoch that a resumed training has already processed."""

    def set_epoch(self, epoch: int) -> None:
        """Set the next epoch; Lightning calls this."""
        self.epoch = epoch

    def __len__(self) -> int:
        return self.repeats * len(self._order())

    def __iter__(self) -> Iterator[tuple[int, ...]]:
        epoch, skip, self.skip = 0 if self.seed is None else self.epoch, self.skip, 0
        keys = [(epoch, index, number) for index in self._order() for number in range(self.repeats)]
        return iter(keys[skip:])

    def _order(self) -> list[int]:
        if self.seed is None:
            # A rank without an item would block the other ranks: it repeats an item.
            return list(range(self.rank, self.n_items, self.world_size)) or [self.rank % self.n_items]
        order = np.random.default_rng((self.seed, self.epoch)).permutation(self.n_items).tolist()
        # All ranks must take equally many steps: wrap around to an even share.
        share = math.ceil(self.n_items / self.world_size)
        return [order[i % self.n_items] for i in range(self.rank, share * self.world_size, self.world_size)]


class EpochLoader(DataLoader[Any]):
    """A loader whose workers start at the first batch: Lightning makes the iterator before it sets the epoch."""

    def __iter__(self) -> Iterator[Any]:  # type: ignore[override]
        yield from super().__iter__()

    def state_dict(self) -> dict[str, Any]:
        """Nothing: the sampler knows from the trainer where to go on. Lightning warns without this method."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Ignore the state, which is empty."""


def epoch_loader(
    module: LightningDataModule,
    items: Dataset[Any],
    sampler: EpochSampler,
    batch_size: int,
    collate: Callable[[list[Any]], Any],
    workers: int | str,
) -> EpochLoader:
    """Batches of a data module; `workers` processes prepare them, `auto`: one, or more for a network on a GPU."""
    trainer = module.trainer
    is_on_gpu = trainer is not None and trainer.accelerator.name() == "cuda"
    if trainer is not None:
        sampler.rank, sampler.world_size = trainer.global_rank, trainer.world_size
        epochs: Any = trainer.fit_loop.epoch_progress.total
        batches: Any = trainer.fit_loop.epoch_loop.batch_progress
        # The checkpoint may have been written in the middle of an epoch.
        within = trainer.fit_loop.restarting and epochs.processed < epochs.started and not batches.is_last_batch
        sampler.skip = batches.current.processed * batch_size if within and sampler.seed is not None else 0
    # Lightning has shared the cores among the processes of a distributed training by now.
    spare = torch.get_num_threads() - 1
    n_workers = min(MOST_WORKERS if is_on_gpu else 1, spare) if workers == "auto" else int(workers)
    return EpochLoader(
        items,
        batch_size=batch_size,
        sampler=sampler,
        collate_fn=collate,
        num_workers=n_workers,
        persistent_workers=n_workers > 0,
        worker_init_fn=_ignore_signals,
        pin_memory=is_on_gpu,
    )


def _ignore_signals(worker: int) -> None:
    """Let a worker ignore SIGINT and SIGTERM, which SLURM sends to all processes: the training needs its batches."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
