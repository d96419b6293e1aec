"""A refocused light field: its stack, disparity and all-in-focus picture, computed when first used."""

import dataclasses
import logging
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from lfref.geometry import FocalPlanes
from lfref.io import images
from lfref.lightfield import LightField
from lfref.refocus import batches
from lfref.refocus.disparity.disparity_map import CLEAR, DisparityMap, disparity_map, order_score
from lfref.refocus.focus.all_in_focus import all_in_focus, extended_focus, index_to_slope
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser import filling
from lfref.report import pictures

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class PictureFiles:
    """Format of picture files; one that cannot be written is an `InputError`."""

    format: str = "png"
    """Format: `png`, `jpg`, `tif` (in tiles), or `avif` if OpenImageIO has it."""
    bits: int = 8
    """Bits per sample: 8, or 16 for PNG and TIFF, or 32 (floating point) for TIFF."""
    quality: int = images.QUALITY
    """Quality of JPEG and AVIF files, from 1 to 100."""

    def __post_init__(self) -> None:
        images.sample_type(Path(f"picture.{self.format}"), self.bits)


def mean_of_views(field: LightField) -> Tensor:
    """Mean of all views by their weights, not refocused, [C, H, W]; black where all weights are 0."""
    if field.weight is None:
        return field.views.mean(dim=(0, 1))
    weight = field.weight.to(field.views)
    total = weight.sum(dim=(0, 1))
    light = torch.where(weight > 0, field.views * weight, 0.0)  # samples of weight 0 may be NaN
    return torch.where(total > 0, light.sum(dim=(0, 1)) / total.clamp(min=1e-6), 0.0)


def brightening(field: LightField) -> float:
    """Factor, at least 1, by which the pictures of a light field are brightened.

    Samples that were encoded for looking at keep their brightness. Dark linear ones are brightened as far as
    `common_exposure` says, but no further than where the share of clipped pixels grows.
    """
    if not field.is_linear or field.metadata.get("encoding", "linear") != "linear":
        return 1.0
    gain = pictures.common_exposure(mean_of_views(field).nan_to_num(0, 0, 0))
    if gain <= 1:
        return 1.0
    brightest = field.views.float().nan_to_num(0, 0, 0).amax(2, keepdim=True)
    brightest = brightest.flatten() if field.weight is None else brightest[field.weight > 0]
    # The brightest pixel that is not clipped, or the brightest of all where as many already are.
    below = int((brightest < 1).sum())
    return max(1.0, min(gain, 1 / float(brightest.kthvalue(below).values))) if below else 1.0


EDGE = 2  # pixels by which operators differ at the edge of what views show, from their interpolation


def without_gaps(stack: Tensor, field: LightField, slopes: Tensor) -> Tensor:
    """A stack [N, C, H, W] for pictures, at slopes [N]: pixels that no view shows continue those around them.

    In a stack these pixels are black, such as the corners of a camera whose optics leave them black in all views.
    """
    if field.weight is None or bool((is_trusted := filling.trusted(field.weight)).any(0).any(0).all()):
        return stack
    share = shift_and_sum(is_trusted.to(torch.float32), slopes, positions=field.positions)
    is_gap = (share <= filling.LEAST * share.amax()).to(stack)
    is_gap = F.interpolate(F.max_pool2d(is_gap, 2 * EDGE + 1, 1, EDGE), stack.shape[-2:]) > 0
    return filling.continued(stack, (~is_gap).to(stack))


@dataclass(frozen=True, eq=False)
class Refocused:
    """A light field and its stack."""

    field: LightField
    stack: Tensor
    """Refocused stack, [N, C, H, W]."""
    planes: FocalPlanes
    gain: float = 1.0
    """Factor of the brightness of all pictures."""
    files: PictureFiles = dataclasses.field(default_factory=PictureFiles)
    foreign_disparity: DisparityMap | None = None
    """Slope of each pixel and its confidence, if another program measured them."""

    @cached_property
    def disparity(self) -> DisparityMap:
        """Disparity and confidence of each pixel of the central view; confidence 0 where no view has weight."""
        estimate = disparity_map(self.field.views, weights=self._view_weights, positions=self.field.positions)
        if self.field.weight is None:
            return estimate
        has_weight = filling.trusted(self.field.weight).flatten(0, 2).any(0)
        return DisparityMap(estimate.disparity, estimate.confidence * has_weight.to(estimate.confidence))

    @cached_property
    def near_sign(self) -> int:
        """1 if larger disparities are probably nearer, else -1."""
        is_measured = self.foreign_disparity is None and self.field.grid != (1, 1)
        return 1 if is_measured and self._order_score > 0 else -1

    @cached_property
    def _order_score(self) -> float:
        return order_score(self.field.views, *self.disparity)

    @property
    def nearness(self) -> Tensor:
        """Disparity, with the sign that makes near points larger, [H, W]."""
        if abs(self._order_score) <= CLEAR:
            warning = "%s: the depth order is not clear; if it is inside out, reverse it by reader.reverse_v=true "
            log.warning(warning + "reader.reverse_u=true", self.field.name)
        return self.near_sign * self.disparity.disparity

    @cached_property
    def by_slope(self) -> list[int]:
        """Indices of the planes from the least slope to the largest, each slope once."""
        return [self.planes.values.index(slope) for slope in sorted(set(self.planes.values))]

    @cached_property
    def shown(self) -> Tensor:
        """The stack as pictures show it, without gaps, [N, C, H, W]."""
        return without_gaps(self.stack, self.field, self.planes.slopes)

    @cached_property
    def mean(self) -> Tensor:
        """Mean of all views, without gaps, [C, H, W]."""
        return without_gaps(mean_of_views(self.field)[None], self.field, torch.zeros(1))[0]

    @cached_property
    def sharp(self) -> Tensor:
        """The picture that is sharp everywhere, [C, H, W]."""
        if self.field.grid == (1, 1):
            return all_in_focus(self.shown[self.by_slope]).image
        views, weight = self.field.views, self.field.weight
        if weight is not None and filling.view_weights(weight) is None:
            # Pixels whose samples have weight in some views only would leave a dark rim.
            light = batches.radiance(views)
            full = filling.filled(light, weight.to(light))
            views = filling.extended(full, filling.trusted(weight), in_place=full is not views)
        return extended_focus(views, self.disparity.disparity, self._view_weights, self.field.positions)

    @cached_property
    def slope_and_confidence(self) -> tuple[Tensor, Tensor]:
        """The slope at which each pixel is sharp, and its confidence, [H, W] each."""
        if self.foreign_disparity is not None:
            return self.foreign_disparity.disparity, self.foreign_disparity.confidence
        if self.field.grid != (1, 1):
            return self.disparity.disparity, self.disparity.confidence
        _, index, confidence = all_in_focus(self.stack[self.by_slope])
        return index_to_slope(index, self.planes.slopes[self.by_slope]), confidence

    @property
    def disparity_picture(self) -> NDArray[np.float64]:
        """The map of slopes in colours, grey where they are unknown, [H, W, 3] in [0, 1]."""
        slopes, confidence = (values.detach().double().cpu().numpy() for values in self.slope_and_confidence)
        ends = pictures.colour_ends(slopes, self.planes.values)
        return pictures.greyed(pictures.coloured(slopes, *ends), confidence)

    @property
    def _view_weights(self) -> Tensor | None:
        """Largest weight of each view, [V, U]."""
        return None if self.field.weight is None else self.field.weight.amax((2, 3, 4))

    def encoded(self, image: Tensor) -> NDArray[np.float32]:
        """An image [C, H, W] with the gain and encoding of all pictures of this light field: [H, W, 3] in [0, 1]."""
        return pictures.for_display(image, self.gain, self.field.picture_encoding)

    def picture(self, image: Tensor) -> NDArray[np.float32]:
        """An image as `encoded` returns it, but with one channel if it is grey."""
        return self.encoded(image)[..., : image.shape[0]]

    def save(self, path: Path, image: Tensor) -> None:
        """Write an image [C, H, W] to a path without suffix."""
        path = path.with_name(f"{path.name}.{self.files.format}")
        images.write_image(path, self.picture(image), bits=self.files.bits, quality=self.files.quality)
