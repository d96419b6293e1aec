"""A refocused light field: its stack, disparity and all-in-focus picture, computed when first used; and its files.

Every picture of a light field has the same brightness.
"""

import dataclasses
import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.io import disparity_files, images, video, write
from lfref.lightfield import LightField
from lfref.refocus import batches
from lfref.refocus.disparity.disparity_map import CLEAR, DisparityMap, disparity_map, order_score
from lfref.refocus.focus.all_in_focus import all_in_focus, extended_focus, index_to_slope
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.surface import per_pixel
from lfref.refocuser import filling
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.report import pictures

log = logging.getLogger(__name__)

SHEET = "contact_sheet.png"
POINT_CONFIDENCE = 0.4
"""Least confidence of a point of the cloud: over half of a capture, 1 in 20 off by .07 px per view step at gloss."""
SWEEP_SECONDS = 2.5
"""Seconds from the first plane to the last, as far as `FRAME_RATES` allows."""
FRAME_RATES = (3.0, 25.0)


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
    """Factor, at least 1, by which dark linear pictures are brightened, as long as hardly more pixels clip."""
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
    """A stack [N, C, H, W] for pictures, at slopes [N]: black pixels that no view shows continue those around them."""
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


def write_results(folder: Path, refocused: Refocused, options: Iterable[str] = ()) -> None:
    """Write stack, planes, contact sheet and mean of all views, and the results of options, keys of `OPTIONAL`."""
    planes, files = refocused.planes, refocused.files
    write.write_stack(folder / "stack.exr", refocused.stack, planes, overwrite=True)
    shown = (refocused.picture(plane).transpose(2, 0, 1) for plane in refocused.shown)
    form: dict[str, Any] = {"suffix": f".{files.format}", "bits": files.bits, "quality": files.quality}
    write.write_pictures(folder / "planes", shown, planes, **form)
    encoding = refocused.field.picture_encoding
    images.write_image(folder / SHEET, pictures.contact_sheet(refocused.shown, planes.titles, refocused.gain, encoding))
    refocused.save(folder / "all_views_mean", refocused.mean)
    for name in options:
        OPTIONAL[name](folder, refocused)


def _all_in_focus(folder: Path, refocused: Refocused) -> None:
    refocused.save(folder / "all_in_focus", refocused.sharp)
    images.write_image(folder / "focus_map.png", refocused.disparity_picture)


def _disparity(folder: Path, refocused: Refocused) -> None:
    folder = folder / "disparity"
    for name, values in zip(("disparity", "confidence"), refocused.disparity, strict=True):
        array = values.float().cpu().numpy()
        disparity_files.write_pfm(folder / f"{name}.pfm", array)
        images.write_image(folder / f"{name}.exr", array[..., None])
    images.write_image(folder / "confidence.png", array[..., None], bits=16)
    images.write_image(folder / "map.png", refocused.disparity_picture)


def _points(folder: Path, refocused: Refocused) -> None:
    disparity, confidence = refocused.disparity
    if not bool((confidence > POINT_CONFIDENCE).any()):
        expected = f"{refocused.field.name} must have pixels of confident disparity"
        raise InputError(expected, got="nothing for points.ply", remedy="leave points=true out")
    cameras = disparity_files.Cameras.from_metadata(refocused.field.metadata)
    coordinates, pixels, unit = disparity_files.points(refocused.nearness, confidence > POINT_CONFIDENCE, cameras)
    # The colour of a point is the mean of all views at its own disparity, not a sample of one view.
    per_point = OperatorRefocuser("per_pixel", per_pixel)
    sharp = per_point.stack(refocused.field.views, refocused.field.weight, disparity)[0]
    colours = _bytes(refocused.encoded(sharp))
    properties = {"disparity": disparity[pixels].numpy(), "confidence": confidence[pixels].numpy()}
    disparity_files.write_points(
        folder / "points.ply", coordinates.numpy(), colours[pixels.numpy()], properties, [unit]
    )


def _sweep(folder: Path, refocused: Refocused) -> None:
    frames = [_bytes(refocused.encoded(refocused.shown[n])) for n in refocused.by_slope]
    rate = min(max(len(frames) / SWEEP_SECONDS, FRAME_RATES[0]), FRAME_RATES[1])
    # There and back: the film begins again where it ends.
    video.write_video(folder / "sweep.mp4", [*frames, *frames[-2:0:-1]], rate)


def _bytes(shown: NDArray[np.float32]) -> NDArray[np.uint8]:
    return np.rint(255 * shown).astype(np.uint8)


Result = Callable[[Path, Refocused], None]
OPTIONAL: dict[str, Result] = {
    "all_in_focus": _all_in_focus,
    "video": _sweep,
    "disparity": _disparity,
    "points": _points,
}
"""Option of `lfref refocus` -> its result."""
