"""Correcting a capture: only defects that it shows; their estimates can be reported, saved and used again."""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from lfref.captures import alignment, black_views, chromatic, exposure, hot_pixels, noise, spacing, vignetting
from lfref.captures.estimates import Defect, Estimates, describe_shape
from lfref.errors import FileError, InputError
from lfref.io import tensor_files
from lfref.lightfield import LightField

VERSION = 1
"""Of all corrections, in the keys of caches: to be raised when corrected light fields change."""

DETECTORS: dict[type[Defect], Callable[[Estimates], Defect]] = {
    hot_pixels.HotPixelsDefect: hot_pixels.find,
    black_views.BlackViewsDefect: black_views.find,
    vignetting.VignettingDefect: vignetting.find,
    exposure.ExposureDefect: exposure.find,
    chromatic.ChromaticDefect: chromatic.find,
    alignment.AlignmentDefect: alignment.find,
    spacing.SpacingDefect: spacing.find,
    noise.NoiseDefect: noise.find,
}
"""Estimator of each defect, in the order of correction: the reverse of the light's way through the camera. Each defect
is estimated in the field that the corrections before have left."""

SMALLEST = 32
"""Least height and width of views: 8 of the 4-pixel blocks that brightness is compared in."""
FORMAT = "lfref corrections 1"
FORMER_FIELDS = {
    "hot_pixels": {"places": "samples"},
    "spacing": {"found": "estimate"},
    "vignetting": {"known": "is_known"},
}
"""Names of fields in files that earlier versions saved."""
AUTO, NONE = "auto", "none"


@dataclass(frozen=True, eq=False)
class Corrections:
    """Estimated defects of a light field, in the order of correction."""

    grid: tuple[int, int]
    """View rows and columns of the light field."""
    size: tuple[int, int]
    """Height and width of its views in pixels."""
    defects: tuple[Defect, ...]
    skipped: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """Name of a defect that was not estimated, or is not corrected -> why."""

    def __getitem__(self, name: str) -> Defect:
        return next(defect for defect in self.defects if defect.name == name)

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the defects that are corrected."""
        return tuple(defect.name for defect in self._active())

    def summary(self) -> str:
        """One line per defect: what is corrected, or why it is not."""
        lines = {}
        for defect in self.defects:
            reason = defect.reason_to_skip()
            lines[defect.name] = f"corrected: {defect.summary()}" if reason is None else f"unchanged: {reason}"
        lines |= {name: f"unchanged: {why}" for name, why in self.skipped.items()}
        return "\n".join(f"{name:12} {text}" for name, text in lines.items())

    def skipping(self, reasons: Mapping[str, str]) -> "Corrections":
        """The same corrections without some of them, given as name -> reason."""
        return dataclasses.replace(self, skipped={**self.skipped, **reasons})

    def apply(self, field: LightField) -> LightField:
        """Correct this light field, or another one of the same camera.

        Args:
            field: Of the same grid and size; what measures or scales light is skipped for encoded samples.

        Raises:
            InputError: Another grid or size.
        """
        if (field.grid, field.size) != (self.grid, self.size):
            (n_rows, n_columns), (height, width) = self.grid, self.size
            expected = f"the corrections are of {n_rows}x{n_columns} views of {height}x{width} pixels"
            raise InputError(expected, got=describe_shape(field))
        for defect in self.skipping(_skipped_of_encoded(field))._active():
            field = defect.corrected(field)
        return field

    def save(self, path: str | Path) -> None:
        """Write a file that `load` reads.

        Raises:
            FileError: It cannot be written.
        """
        values = {
            defect.name: {field.name: getattr(defect, field.name) for field in dataclasses.fields(defect)}  # type: ignore[arg-type]
            for defect in self.defects
            if defect.reason_to_skip() is None
        }
        content = {"format": FORMAT, "grid": self.grid, "size": self.size, "findings": values}
        tensor_files.write_checkpoint(path, content)

    def _active(self) -> list[Defect]:
        return [
            defect for defect in self.defects if defect.reason_to_skip() is None and defect.name not in self.skipped
        ]


def correct(
    field: LightField, white: LightField | None = None, profile: Corrections | str | Path | None = None
) -> tuple[LightField, Corrections]:
    """Correct the defects that a light field shows, and no others.

    Args:
        field: A capture, or any light field. For encoded samples (`encoding=none`), only alignment, spacing, colours'
            places, black views and hot pixels are corrected.
        white: A picture of a white scene by the same camera, of the same grid and size.
        profile: Corrections of another capture of the camera, or their file; applied without new estimates.

    Returns:
        The light field, itself where nothing is corrected; and the corrections.

    Raises:
        InputError: A white picture or a profile of another grid or size, both of them, or a white picture of encoded
            samples.
        FileError: The profile cannot be read.

    Example:
        >>> field = lfref.LightField(torch.full((5, 5, 3, 64, 80), 0.5))
        >>> corrected, corrections = lfref.correct(field)
        >>> corrected is field, corrections.active
        (True, ())
    """
    if profile is not None and white is not None:
        expected = "corrections are estimated, with a white picture if there is one, or taken from a profile"
        raise InputError(expected, got="a white picture and a profile", remedy="leave one of them out")
    if profile is not None:
        corrections = profile if isinstance(profile, Corrections) else load(profile)
        return corrections.apply(field), corrections.skipping(_skipped_of_encoded(field))
    return estimate_and_correct(Estimates(field, white))


def correct_by_option(
    field: LightField, option: str, white: LightField | None = None, even_grid_for: str | None = None
) -> tuple[LightField, Corrections | None]:
    """Correct a light field as the option `correct` says; the corrections are None for `none`.

    Args:
        field: As it was read.
        option: `auto`, `none`, or a file that `Corrections.save` wrote.
        white: A picture of a white scene by the same camera.
        even_grid_for: Why cameras must stay on an even grid; their spacing is then reported, not corrected.

    Raises:
        InputError: A white picture or corrections of another grid or size.
        FileError: The file of corrections cannot be read.
    """
    if option == NONE:
        return field, None
    corrected, corrections = correct(field, white, None if option == AUTO else option)
    if even_grid_for is None or corrected.positions is field.positions:
        return corrected, corrections
    name = spacing.SpacingDefect.name
    corrections = corrections.skipping({name: f"{corrections[name].summary()}, but {even_grid_for}"})
    return dataclasses.replace(corrected, positions=field.positions), corrections


def estimate_and_correct(estimates: Estimates) -> tuple[LightField, Corrections]:
    """As `correct`, from estimates that are there already."""
    field, defects = estimates.field, list[Defect]()
    skipped = _skipped_of_unusable(field) or _skipped_of_encoded(field)
    for kind, find in DETECTORS.items():
        if kind.name in skipped:
            continue
        defects.append(defect := find(estimates))
        if defect.reason_to_skip() is None:
            estimates = Estimates(defect.corrected(estimates.field), estimates.white)
    return estimates.field, Corrections(field.grid, field.size, tuple(defects), skipped)


def _skipped_of_unusable(field: LightField) -> dict[str, str]:
    """All defects, each with the reason why this light field allows no estimate; none where it does."""
    # The extremes are NaN where any sample is; `isfinite` of all samples would take three times as long.
    is_finite = all(bool(extreme.isfinite()) for extreme in field.views.aminmax())
    reasons = {
        f"views are smaller than {SMALLEST} pixels": min(field.size) < SMALLEST,
        "a single view cannot be compared": field.grid == (1, 1),
        "views hold NaN or infinity": not is_finite,
    }
    return {kind.name: reason for reason, holds in reasons.items() if holds for kind in DETECTORS}


def _skipped_of_encoded(field: LightField) -> dict[str, str]:
    reason = "encoded samples are no light (reader.encoding=none)"
    return {} if field.is_linear else {kind.name: reason for kind in DETECTORS if kind.needs_light}


def load(path: str | Path) -> Corrections:
    """Read a file that `Corrections.save` wrote, in this version or an earlier one.

    Raises:
        FileError: It is missing, damaged, or another file.
    """
    remedy = "give a file that correct=auto wrote, correction.pt"
    if not Path(path).is_file():
        raise FileError(f"no corrections at {path}", remedy=remedy)
    try:
        content: Any = torch.load(path, weights_only=True, map_location="cpu")
    except Exception as error:  # torch raises errors of many kinds for damaged archives
        got = "another kind of file, or a damaged one"
        raise FileError(f"{path} must hold corrections", got=got, remedy=remedy) from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise FileError(f"{path} must hold corrections", got="another file", remedy=remedy)
    kinds = {kind.name: kind for kind in DETECTORS}
    try:
        defects = []
        for name, fields in content["findings"].items():
            current = FORMER_FIELDS.get(name, {})
            defects.append(kinds[name](**{current.get(field, field): value for field, value in fields.items()}))
        return Corrections(tuple(content["grid"]), tuple(content["size"]), tuple(defects))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        got = f"entries that cannot be read ({error})"
        raise FileError(f"{path} must hold corrections", got=got, remedy=remedy) from error
