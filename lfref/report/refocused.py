"""A light field that was refocused, with what else is known of it once somebody asks, and how its pictures look."""

import dataclasses
import logging
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.errors import InputError, chosen
from lfref.geometry import FocalPlanes
from lfref.io import images
from lfref.lightfield import LightField
from lfref.refocus.disparity.disparity_map import DisparityMap, depth_order, disparity_map
from lfref.refocus.focus.all_in_focus import all_in_focus, index_to_slope
from lfref.refocus.focus.extended_focus import extended_focus
from lfref.refocuser import filling
from lfref.report import pictures

log = logging.getLogger(__name__)

SUFFIXES = {"png": ".png", "jpg": ".jpg", "tif": ".tif", "avif": ".avif"}


@dataclass(frozen=True)
class PictureFiles:
    """What pictures are written as.

    Raises:
        InputError: There is no such format, or it has no such depth or quality.
    """

    format: str = "png"
    """`png`, `jpg`, `tif` (in tiles) or, where OpenImageIO has it, `avif`."""
    bits: int = 8
    """8 or, of PNG and TIFF, 16; of TIFF also 32, in floating point."""
    quality: int = images.QUALITY
    """Of JPEG and AVIF, from 1 to 100."""

    def __post_init__(self) -> None:
        suffix = chosen("format", self.format, SUFFIXES)
        images.sample_type(Path(f"x{suffix}"), None)
        depths = images.DEPTHS[suffix]
        if self.bits not in depths:
            raise InputError(f"bits of {self.format} must be {' or '.join(map(str, depths))}", got=repr(self.bits))
        if not 1 <= self.quality <= 100:
            raise InputError("quality must be from 1 to 100", got=repr(self.quality))

    @property
    def suffix(self) -> str:
        """Of the files' names."""
        return SUFFIXES[self.format]


def mean_of_views(field: LightField) -> Tensor:
    """The mean of all views, not refocused; samples count as much as they weigh.

    Args:
        field: The light field.

    Returns:
        [C, H, W]; black where no sample weighs anything.
    """
    if field.weight is None:
        return field.views.mean(dim=(0, 1))
    weight = field.weight.to(field.views)
    total = weight.sum(dim=(0, 1))
    return torch.where(total > 0, (field.views * weight).sum(dim=(0, 1)) / total.clamp(min=1e-6), 0.0)


@dataclass(frozen=True, eq=False)
class Refocused:
    """A light field and what was made of it."""

    field: LightField
    stack: Tensor
    """[N, C, H, W]."""
    planes: FocalPlanes
    """The N planes."""
    gain: float = 1.0
    """What all pictures are multiplied by."""
    files: PictureFiles = dataclasses.field(default_factory=PictureFiles)
    """What pictures are written as."""

    @cached_property
    def disparity(self) -> DisparityMap:
        """Disparity and confidence of each pixel of the central view; none where no view has a sample of weight."""
        found = disparity_map(self.field.views, weights=self._view_weights, positions=self.field.positions)
        if self.field.weight is None:
            return found
        is_seen = filling.trusted(self.field.weight).flatten(0, 2).any(0)
        return DisparityMap(found.disparity, found.confidence * is_seen.to(found.confidence))

    @cached_property
    def nearness(self) -> Tensor:
        """Disparity with the sign by which larger is nearer, [H, W]."""
        sign = depth_order(self.field.views, *self.disparity)
        if not sign:
            remedy = "if the points turn out inside out, give reader.reverse_v=true reader.reverse_u=true"
            log.warning("%s: smaller disparities are taken for nearer ones; %s", self.field.name, remedy)
        return (sign or -1) * self.disparity.disparity

    @cached_property
    def rising(self) -> list[int]:
        """Planes from the least slope to the largest, none of them twice."""
        return [self.planes.values.index(slope) for slope in sorted(set(self.planes.values))]

    @cached_property
    def sharp(self) -> Tensor:
        """The picture that is sharp everywhere, of the views that show the same point, [C, H, W]."""
        if self.field.grid == (1, 1):
            return all_in_focus(self.stack[self.rising]).image
        return extended_focus(self.field.views, self.disparity.disparity, self._view_weights, self.field.positions)

    @cached_property
    def focused(self) -> tuple[Tensor, Tensor]:
        """The slope at which each pixel is sharp, and how sure that is, [H, W] each."""
        if self.field.grid != (1, 1):
            return self.disparity.disparity, self.disparity.confidence
        _, index, confidence = all_in_focus(self.stack[self.rising])
        return index_to_slope(index, self.planes.slopes[self.rising]), confidence

    @property
    def _view_weights(self) -> Tensor | None:
        """How far each view is to be trusted, [V, U]."""
        return None if self.field.weight is None else self.field.weight.amax((2, 3, 4))

    def shown(self, image: Tensor) -> NDArray[np.float32]:
        """An image as all pictures of this light field show it.

        Args:
            image: [C, H, W].

        Returns:
            [H, W, 3] in [0, 1].
        """
        return pictures.for_display(image, self.gain, self.field.picture_encoding)

    def picture(self, image: Tensor) -> NDArray[np.float32]:
        """As `shown`, but grey stays one channel."""
        return self.shown(image)[..., : image.shape[0]]

    def save(self, path: Path, image: Tensor) -> None:
        """Write an image [C, H, W] under a name without suffix."""
        path = path.with_name(path.name + self.files.suffix)
        images.write_image(path, self.picture(image), bits=self.files.bits, quality=self.files.quality)
