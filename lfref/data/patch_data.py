"""Random patches of light fields with their labels, each repeatable by (seed, epoch, index).

One item is one light field: its patches are cut together, so that a field is read or rendered once an epoch.
Where a patch is flat there is nothing to learn, and normalisation divides by nearly nothing: another one is drawn.
"""

import math
from collections.abc import Iterator, Sequence
from typing import TypedDict

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset, Sampler

from lfref.data.field_sources import Field, Source
from lfref.data.label_sources import Labels
from lfref.errors import InputError

FLAT = 1 / 255
"""Least difference between the brightest and the darkest sample of a patch's views: a step of 8 bits."""
DRAWS = 8
"""Corners drawn for a patch before it is left out."""


class Batch(TypedDict):
    """Patches of one or more light fields."""

    views: Tensor
    """[P, V, U, C, H, W] in [0, 1]."""
    labels: Tensor
    """[P, N, C, H, W]."""
    slopes: Tensor
    """Of the labels' planes, in pixels per view step, float64, [N]."""
    where: list[str]
    """Light field and top left corner of each patch, P entries."""
    resampled: int
    """Corners that were drawn again because the patch there is flat."""


def cut(field: Field, labels: Labels, top: int, left: int, patch: int) -> tuple[Tensor, Tensor] | None:
    """One patch and its label, made with as much surroundings as the label depends on.

    Args:
        field: To cut from.
        labels: Makes the label.
        top: First row, in pixels.
        left: First column, in pixels.
        patch: Height and width in pixels.

    Returns:
        Views [V, U, C, patch, patch] and label [N, C, patch, patch]; None if the views are flat.
    """
    margin = labels.margin(field.grid)
    rows, columns = (
        _context(start, patch, margin, length) for start, length in zip((top, left), field.size, strict=True)
    )
    context = field.crop(rows.start, columns.start, len(rows), len(columns))
    row, column = top - rows.start, left - columns.start
    window = (..., slice(row, row + patch), slice(column, column + patch))
    views = context.views[window].contiguous()
    darkest, brightest = views.aminmax()
    if brightest - darkest < FLAT:  # false of what is not finite, which is left to those who can name it
        return None
    return views, labels(context)[window].contiguous()


def _context(start: int, patch: int, margin: int, length: int) -> range:
    """A patch with its margin along one axis, as far as the field reaches and wide enough for the largest shift."""
    least = 2 * margin + 1
    first = max(0, min(start - margin, length - least))
    return range(first, min(length, max(start + patch + margin, first + least)))


class FieldPatches(Dataset[Batch]):
    """Random patches of every light field of a source.

    Args:
        source: Light fields.
        labels: Makes the labels.
        patch: Height and width in pixels.
        patches_per_field: Patches cut from a field in an epoch.
        seed: Of the corners.

    Raises:
        InputError: A size below 1; later, a field smaller than a patch, or no field with anything to see in it.
    """

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
            "light fields must have something to see in them",
            got=f"{len(self)} whose patches are flat",
            remedy="give other fields, or set data.patch larger",
        )

    def _of_field(self, epoch: int, index: int) -> Batch | None:
        """The patches of one field, None if it is flat wherever one was drawn."""
        field = self.source.field(index, epoch)
        if min(field.size) < self.patch:
            raise InputError(
                f"light field {field.name} must be at least {self.patch} pixels in both directions",
                got=f"{field.size[0]}x{field.size[1]}",
                remedy="set data.patch smaller",
            )
        random = np.random.default_rng((self.seed, epoch, index))
        drawn = [drawn for _ in range(self.patches_per_field) for drawn in self._draw(field, random)]
        found = [(where, *pair) for where, pair in drawn if pair is not None]
        if not found:
            return None
        where, views, stacks = zip(*found, strict=True)
        return {
            "views": torch.stack(views),
            "labels": torch.stack(stacks),
            "slopes": self.labels.planes.slopes,
            "where": list(where),
            "resampled": len(drawn) - len(found),
        }

    def _draw(self, field: Field, random: np.random.Generator) -> Iterator[tuple[str, tuple[Tensor, Tensor] | None]]:
        """Corners and what is cut there, up to the first that is not flat."""
        free = np.array(field.size) - self.patch
        for _ in range(DRAWS):
            top, left = random.integers(0, free + 1).tolist()
            pair = cut(field, self.labels, top, left, self.patch)
            yield f"{field.name}@{top},{left}", pair
            if pair is not None:
                return


class EpochSampler(Sampler[tuple[int, int]]):
    """Yields (epoch, index), shuffled by (seed, epoch) and shared out among the ranks of a distributed run.

    Carrying the epoch in the key lets workers that live on see it, and makes a resumed run draw what an unbroken one
    would have drawn.

    Args:
        n_items: Items in an epoch.
        seed: Of the order; None keeps the order and stays at epoch 0, as validation wants.
        rank: This process.
        world_size: Number of processes.
    """

    def __init__(self, n_items: int, seed: int | None, rank: int = 0, world_size: int = 1) -> None:
        self.n_items = n_items
        self.seed = seed
        self.rank = rank
        self.world_size = world_size
        self.epoch = 0

    def set_epoch(self, epoch: int) -> None:
        """Tell which epoch comes next; Lightning calls this."""
        self.epoch = epoch

    def __len__(self) -> int:
        return len(self._order())

    def __iter__(self) -> Iterator[tuple[int, int]]:
        epoch = 0 if self.seed is None else self.epoch
        return ((epoch, index) for index in self._order())

    def _order(self) -> list[int]:
        if self.seed is None:
            # A rank without an item would bring the others to a halt: it repeats one.
            return list(range(self.rank, self.n_items, self.world_size)) or [self.rank % self.n_items]
        order = np.random.default_rng((self.seed, self.epoch)).permutation(self.n_items).tolist()
        # Every rank must take as many steps as the others: wrap around to an even share.
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
