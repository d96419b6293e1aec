"""Random patches of light fields with their labels, repeatable by (seed, epoch, index).

One item is one light field. Its patches are cut together, so that a field is read or rendered once per epoch. A flat
patch is drawn again: a network learns nothing from it, and normalisation would divide by nearly 0. Patches are handed
over as they are stored, with the margin that their labels depend on; `labelled` decodes them and makes the labels, in
the threads that prepare batches, or on the device of the network.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypedDict

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from lfref.data.field_sources import Field, SimulatedField, Source
from lfref.data.label_sources import Labels
from lfref.data.stored_fields import StoredCrop, StoredField
from lfref.errors import InputError, counted
from lfref.io import images
from lfref.lightfield import LightField
from lfref.refocus import batches

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


@dataclass(frozen=True, eq=False)
class Patch:
    """A patch within the samples that its label depends on."""

    context: LightField | StoredCrop
    """The patch and a margin, as stored or simulated."""
    top: int
    """First row of the patch in its context."""
    left: int
    """First column of the patch in its context."""
    size: int
    """Height and width of the patch in pixels."""
    where: str
    """Light field and top left corner, NAME@TOP,LEFT."""

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the patch in its context."""
        return slice(self.top, self.top + self.size), slice(self.left, self.left + self.size)

    def is_flat(self) -> bool:
        """Whether all samples of the patch's views are alike within one 8-bit level; not if one is NaN."""
        samples = self.context.views[..., *self.window].numpy()
        ends = np.array([[samples.min(), samples.max()]])
        if isinstance(self.context, StoredCrop):
            ends = images.decoded(ends, self.context.encoding)
        return bool(ends[0, 1] - ends[0, 0] < FLAT)

    def of_views(self) -> "Patch":
        """The same patch without its scene, which cannot be sent to other processes."""
        if not isinstance(self.context, SimulatedField):
            return self
        light = LightField(self.context.views.contiguous(), self.context.name, self.context.weight)
        return replace(self, context=light)

    def pair(self, labels: Labels) -> tuple[Tensor, Tensor]:
        """Views [V, U, C, size, size] and label [N, C, size, size] within their margins, on the samples' device."""
        light = self.context if isinstance(self.context, LightField) else self.context.light()
        return light.views[..., *self.window], labels.window(light, *self.window)

    def to(self, device: torch.device, **options: Any) -> "Patch":
        """The same patch on a device."""
        return replace(self, context=self.context.to(device, **options))

    def pin_memory(self) -> "Patch":
        """The same patch in memory from which a GPU can copy it in the background."""
        return replace(self, context=self.context.pin_memory()) if isinstance(self.context, StoredCrop) else self


class UnlabelledBatch(TypedDict):
    """Patches of one or more light fields, without labels."""

    patches: list[Patch]
    slopes: Tensor
    """As in `Batch`."""
    resampled: int
    """As in `Batch`."""


def labelled(batch: UnlabelledBatch, labels: Labels) -> Batch:
    """Decode the patches of a batch, and make their labels, on the device of the patches."""
    views, stacks = zip(*(patch.pair(labels) for patch in batch["patches"]), strict=True)
    return {
        "views": torch.stack(views),
        "labels": torch.stack(stacks),
        "slopes": batch["slopes"],
        "where": [patch.where for patch in batch["patches"]],
        "resampled": batch["resampled"],
    }


def cut(field: Field, labels: Labels, top: int, left: int, size: int, has_margin: bool = True) -> Patch:
    """The patch at a corner of a light field, with what its label depends on, as far as the field reaches.

    The crop is wide enough for the largest shift, however small the patch. Without a margin it is the patch alone.
    """
    if not has_margin:
        return Patch(_crop(field, top, left, size, size), 0, 0, size, f"{field.name}@{top},{left}")
    margin, crop = labels.margin(field.grid), []
    for start, length in zip((top, left), field.size, strict=True):
        first = max(0, min(start - margin, length - 2 * margin - 1))
        last = min(length, max(start + size + margin, first + 2 * margin + 1))
        n_pixels = min(length, labels.crop_length(last - first))
        crop.append((min(first, length - n_pixels), n_pixels))
    (row, height), (column, width) = crop
    context = _crop(field, row, column, height, width)
    return Patch(context, top - row, left - column, size, f"{field.name}@{top},{left}")


def _crop(field: Field, *window: int) -> LightField | StoredCrop:
    """The crop of a field, as float32 without gradients unless it is stored."""
    crop = field.crop(*window)
    if isinstance(crop, LightField) and (crop.views.dtype != torch.float32 or crop.views.requires_grad):
        crop = replace(crop, views=batches.radiance(crop.views.detach()).float())
    return crop


class FieldPatches(Dataset[UnlabelledBatch]):
    """Random patches of every light field of a source; `seed` fixes the corners, `has_margin` as for `cut`."""

    def __init__(
        self, source: Source, labels: Labels, patch: int, patches_per_field: int, seed: int, has_margin: bool = True
    ) -> None:
        if min(patch, patches_per_field) < 1:
            raise InputError("patch and patches_per_field must be at least 1", got=(patch, patches_per_field))
        self.source = source
        self.labels = labels
        self.patch = patch
        self.patches_per_field = patches_per_field
        self.seed = seed
        self.has_margin = has_margin

    def __len__(self) -> int:
        return len(self.source)

    def __getitem__(self, key: tuple[int, int]) -> UnlabelledBatch:
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

    def _of_field(self, epoch: int, index: int) -> UnlabelledBatch | None:
        """The patches of one field; None if all drawn patches are flat."""
        field = self.source.field(index, epoch)
        if not isinstance(field, LightField | StoredField):
            remedy = 'see "Interface of each part" in docs/extending.md'
            expected = f"{type(self.source).__name__}.field must return a LightField"
            raise InputError(expected, got=type(field).__name__, remedy=remedy)
        if min(field.size) < self.patch:
            raise InputError(
                f"light field {field.name} must be at least {self.patch} pixels in both directions",
                got=f"{field.size[0]}x{field.size[1]}",
                remedy="set data.patch smaller",
            )
        random = np.random.default_rng((self.seed, epoch, index))
        draws = [draw for _ in range(self.patches_per_field) for draw in self._draw(field, random)]
        patches = [patch for patch in draws if patch is not None]
        if not patches:
            return None
        slopes = self.labels.planes.slopes
        return {"patches": patches, "slopes": slopes, "resampled": len(draws) - len(patches)}

    def _draw(self, field: Field, random: np.random.Generator) -> Iterator[Patch | None]:
        """Patches at random corners, up to the first patch that is not flat; a flat patch is None."""
        free = np.array(field.size) - self.patch
        for _ in range(DRAWS):
            top, left = random.integers(0, free + 1).tolist()
            patch = cut(field, self.labels, top, left, self.patch, self.has_margin)
            if not patch.is_flat():
                yield patch.of_views() if self.labels.reads_views else patch
                return
            yield None


def concatenate(items: Sequence[UnlabelledBatch]) -> UnlabelledBatch:
    """Join the patches of several light fields into one batch."""
    return {
        "patches": [patch for item in items for patch in item["patches"]],
        "slopes": items[0]["slopes"],
        "resampled": sum(item["resampled"] for item in items),
    }
