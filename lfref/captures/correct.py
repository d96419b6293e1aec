"""Correcting a capture: the defects that it shows, and no others; the estimates can be reported, saved and used again.

The sequence runs in the reverse order of the light path, and estimates each defect in the light field that the
corrections before it return.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.captures import Defect, bad_pixels, brightness, chromatic, registration, view_order, vignetting
from lfref.captures.bad_pixels import BlackViewsDefect, HotPixelsDefect
from lfref.captures.brightness import ExposureDefect
from lfref.captures.chromatic import ChromaticDefect
from lfref.captures.registration import AlignmentDefect, Registration, SpacingDefect
from lfref.captures.view_order import ViewOrderDefect
from lfref.captures.vignetting import VignettingDefect
from lfref.errors import CheckpointError, FileError, InputError, first_line
from lfref.io import tensor_files
from lfref.lightfield import LightField
from lfref.refocus.focus import slope_range
from lfref.refocus.focus.slope_range import CoarseDisparity, ReducedViews

VERSION = 6  # of all corrections, a part of cache keys; raise it when corrected light fields change
SMALLEST = 32  # pixels, height and width of views: 8 of the 4-pixel blocks in which brightness is compared
TEXTURE = 0.01  # difference of the root of light of neighbours in a texture
LEAST_TEXTURED = 0.1  # share of the picture with textures from which views that do not fit together are not compared
FORMAT = "lfref corrections 7"
AUTO, NONE = "auto", "none"
KINDS: tuple[type[Defect], ...] = (
    ViewOrderDefect,
    HotPixelsDefect,
    BlackViewsDefect,
    VignettingDefect,
    ExposureDefect,
    ChromaticDefect,
    AlignmentDefect,
    SpacingDefect,
)
"""All defects in the order of correction."""


class CentralView(NamedTuple):
    """Disparity of the central view, from which all estimates start."""

    reference: tuple[int, int]  # row and column of the view to which the maps belong, such as (7, 7) of 14x14
    disparity: Tensor
    """Disparity in pixels per view step, [H, W]. Reduced pixels are repeated: no value lies between two surfaces."""
    confidence: Tensor
    """Confidence in [0, 1], [H, W]; above 1/2 the standard error of the disparity is below .03 reduced pixels."""
    coarse: CoarseDisparity  # the same maps at low resolution
    reduced: ReducedViews  # the small views from which the maps were estimated

    @property
    def slopes(self) -> tuple[float, float] | None:
        """Range of the scene's disparities, in pixels per view step; None: unknown."""
        return slope_range.slope_range(self.coarse)

    @property
    def is_comparable(self) -> bool:
        """Whether the places of a point in all views are known, or do not matter, as in a picture of a white wall."""
        picture = self.reduced.pictures[0]
        differences = picture[1:, 1:] - picture[:-1, :-1]
        return self.slopes is not None or float((differences.abs() > TEXTURE).float().mean()) < LEAST_TEXTURED


@dataclass(frozen=True, eq=False)
class Corrections:
    """What estimates found in a light field of a grid and size."""

    grid: tuple[int, int]
    size: tuple[int, int]
    defects: tuple[Defect, ...]
    """Defects that show, in the order of correction."""
    unchanged: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """Name of a defect that does not show -> what the estimate found."""
    skipped: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """Name of a defect that was not estimated, or is not corrected on request -> why."""

    def __getitem__(self, name: str) -> Defect:
        return next(defect for defect in self.defects if defect.name == name)

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the defects that are corrected."""
        return tuple(defect.name for defect in self.defects if defect.name not in self.skipped)

    def texts(self) -> dict[str, str]:
        """Name of each defect -> what is corrected, or why it is not."""
        reasons = {name: f"unchanged: {reason}" for name, reason in {**self.unchanged, **self.skipped}.items()}
        texts = reasons | {name: f"corrected: {self[name].summary()}" for name in self.active}
        return {kind.name: texts[kind.name] for kind in KINDS if kind.name in texts}

    def summary(self) -> str:
        """The same as lines."""
        return "\n".join(f"{name:12} {text}" for name, text in self.texts().items())

    def skipping(self, reasons: Mapping[str, str]) -> "Corrections":
        """The same corrections without some of them, given as name -> reason."""
        return dataclasses.replace(self, skipped={**self.skipped, **reasons})

    def apply(self, field: LightField) -> LightField:
        """Correct a light field of the same grid and size; encoded samples skip corrections that need linear light."""
        if (field.grid, field.size) != (self.grid, self.size):
            raise InputError(f"the corrections are of {_shape(self)}", got=_shape(field))
        for name in self.skipping(_skipped_of_encoded(field)).active:
            field = self[name].corrected(field)
        return field

    def save(self, path: str | Path) -> None:
        """Write a file that `load` reads."""
        # Not `dataclasses.asdict`, which copies tensors.
        findings = {defect.name: vars(defect) for defect in self.defects}
        contents = {"format": FORMAT, "grid": self.grid, "size": self.size, "findings": findings}
        tensor_files.write_checkpoint(path, contents)


def load(path: str | Path) -> Corrections:
    """Read a file that `Corrections.save` wrote; any other file raises FileError."""
    path, kinds = Path(path), {kind.name: kind for kind in KINDS}
    try:
        contents = tensor_files.read_checkpoint(path)
        if contents["format"] != FORMAT:
            raise ValueError("another format")
        defects = tuple(kinds[name](**values) for name, values in contents["findings"].items())
        return Corrections(tuple(contents["grid"]), tuple(contents["size"]), defects)
    except (CheckpointError, AttributeError, KeyError, TypeError, ValueError) as error:
        remedy = "give a file that correct=auto wrote, correction.pt"
        raise FileError(f"{path} must hold corrections", got=first_line(error), remedy=remedy) from error


def correct(
    field: LightField,
    how: Corrections | str | Path = AUTO,
    flat_field: LightField | None = None,
    even_grid_for: str | None = None,
    in_place: bool = False,
) -> tuple[LightField, Corrections]:
    """Correct the defects that a light field shows, and no others.

    Args:
        field: A capture, or any light field. For encoded samples (`encoding=none`), only hot pixels, black views,
            chromatic aberration, alignment and spacing are corrected.
        how: `auto` estimates the defects; `none` corrects nothing; corrections of another capture of the camera, or
            their file, are applied without new estimates.
        flat_field: A picture of a white scene by the same camera, of the same grid and size, for `auto`.
        even_grid_for: Why cameras must stay on an even grid, if so; their spacing is then reported, not corrected.
        in_place: Whether estimated corrections may overwrite the views of `field`, which saves as much memory.

    Returns:
        The corrected light field (`field` itself if nothing is corrected), and the corrections. Estimates have no
        gradients, nor have views that are corrected by them; those corrected by given corrections do.

    Raises:
        InputError: The flat field or the corrections have another grid or size; there is a flat field for given
            corrections; or it has encoded samples.
        FileError: The corrections cannot be read.

    Example:
        >>> field = lfref.LightField(torch.full((5, 5, 3, 64, 80), 0.5))
        >>> corrected, corrections = lfref.correct(field)
        >>> corrected is field, corrections.active
        (True, ())
    """
    if how == NONE:
        return field, Corrections(field.grid, field.size, ())
    if how == AUTO:
        if flat_field and (_shape(flat_field) != _shape(field) or (field.is_linear and not flat_field.is_linear)):
            expected = f"the flat field must have the {_shape(field)} of {field.name or 'the light field'}, as linear"
            raise InputError(expected, got=_shape(flat_field), remedy="read both with the same reader options")
        corrected, corrections = _estimate_and_correct(field, flat_field, in_place)
    elif flat_field is not None:
        raise InputError("a flat field is for correct=auto", got=f"correct={how}", remedy="leave flat_field= out")
    else:
        corrections = how if isinstance(how, Corrections) else load(how)
        corrections = corrections.skipping(_skipped_of_encoded(field))
        corrected = corrections.apply(field)
    if even_grid_for and SpacingDefect.name in corrections.active:
        # This correction is the last one, and moves nothing but positions.
        spacing, corrected = corrections[SpacingDefect.name], dataclasses.replace(corrected, positions=field.positions)
        corrections = corrections.skipping({spacing.name: f"{spacing.summary()}, but {even_grid_for}"})
    return corrected, corrections


@torch.no_grad()
def _estimate_and_correct(
    field: LightField, flat_field: LightField | None, in_place: bool
) -> tuple[LightField, Corrections]:
    """Estimate all defects in turn, and correct those that show."""
    grid, size, skipped = field.grid, field.size, _skipped_of_encoded(field)
    reason = f"views are smaller than {SMALLEST} pixels" if min(size) < SMALLEST else ""
    reason = "a single view cannot be compared" if grid == (1, 1) else reason
    if not bool(field.views.isfinite().all()):
        reason = "views hold NaN or infinity"
    if reason:
        return field, Corrections(grid, size, (), skipped={kind.name: reason for kind in KINDS})
    defects: list[Defect] = []
    unchanged: dict[str, str] = {}

    def correct_if_due(kind: type[Defect], defect: Defect | str) -> bool:
        """Note what an estimate found, and correct the light field if a defect shows; returns whether one does."""
        nonlocal field
        if isinstance(defect, str):
            unchanged[kind.name] = defect
            return False
        defects.append(defect)
        corrected = defect.corrected(field)
        if in_place and corrected.views is not field.views and corrected.views.shape == field.views.shape:
            field.views.copy_(corrected.views)
            corrected = dataclasses.replace(corrected, views=field.views)
        field = corrected
        return True

    # Each correction changes the estimates after it.
    view = central_view(field)
    if correct_if_due(ViewOrderDefect, view_order.find(view.reduced)):
        view = central_view(field)
        flat_field = flat_field and defects[0].corrected(flat_field)  # it was read in the same order
    is_new = correct_if_due(HotPixelsDefect, bad_pixels.find_hot(field, view.disparity, view.reference))
    is_new |= correct_if_due(BlackViewsDefect, bad_pixels.find_black(field))
    if flat_field and field.is_linear:
        # It compares no views of the light field. Strong shading may be why they show nothing in common.
        is_new |= correct_if_due(VignettingDefect, vignetting.find_by_flat_field(flat_field))
    view = central_view(field) if is_new else view
    if not view.is_comparable:
        names = [ExposureDefect.name, *([VignettingDefect.name] if flat_field is None else [])]
        skipped = dict.fromkeys(names, "unknown: the views show no common disparities") | skipped
    elif field.is_linear:
        ratios = brightness.ratios(field, view.disparity, view.reference)
        if flat_field is None and (even := _evenly_lit(field, view, ratios)) is not field:
            # Views of one brightness have better disparities, on which the estimates depend.
            better = central_view(even)
            ratios = brightness.ratios(field, better.disparity, better.reference)
        if flat_field is None and correct_if_due(VignettingDefect, vignetting.find(ratios)):
            view = central_view(field)
            ratios = brightness.ratios(field, view.disparity, view.reference)
        if correct_if_due(ExposureDefect, brightness.find_exposure(ratios)):
            view = central_view(field)
    registered = _registration(field, view)
    if correct_if_due(ChromaticDefect, chromatic.find(field, registered)):
        view = central_view(field)
        registered = _registration(field, view)
    if correct_if_due(AlignmentDefect, registration.find_alignment(registered)):
        view = central_view(field)
        registered = _registration(field, view)
    correct_if_due(SpacingDefect, registration.find_spacing(registered))
    return field, Corrections(grid, size, tuple(defects), unchanged, skipped)


def _evenly_lit(field: LightField, view: CentralView, ratios: brightness.Ratios) -> LightField:
    """The light field after first corrections of vignetting and exposure; the same one if neither shows."""
    shading = vignetting.find(ratios)
    if isinstance(shading, VignettingDefect):
        field = shading.corrected(field)
        ratios = brightness.ratios(field, view.disparity, view.reference)
    exposure = brightness.find_exposure(ratios)
    return exposure.corrected(field) if isinstance(exposure, ExposureDefect) else field


def _registration(field: LightField, view: CentralView) -> Registration | None:
    """Registration of the views; None where no disparities are known, from which it would start."""
    return None if view.slopes is None else registration.register(field, view.disparity, view.reference)


def central_view(field: LightField) -> CentralView:
    """Estimate the disparity of the central view; takes some milliseconds."""
    reduced = slope_range.reduce_views(field.views, field.weight, field.positions)
    coarse = slope_range.disparity_of_reduced(reduced)
    # The last reduced row and column also cover the rest up to the border.
    rows, columns = (
        (torch.arange(length) // coarse.factor).clamp(max=n - 1)
        for length, n in zip(field.size, coarse.disparity.shape, strict=True)
    )
    disparity, confidence = (small[rows][:, columns] for small in (coarse.disparity, coarse.confidence))
    return CentralView(reduced.indices[0], disparity, confidence, coarse, reduced)


def _skipped_of_encoded(field: LightField) -> dict[str, str]:
    reason = "encoded samples are no light (reader.encoding=none)"
    return {} if field.is_linear else {kind.name: reason for kind in KINDS if kind.needs_light}


def _shape(field: "LightField | Corrections") -> str:
    """Grid and size for messages."""
    return f"{field.grid[0]}x{field.grid[1]} views of {field.size[0]}x{field.size[1]} pixels"
