"""Putting a capture right: only what it shows is corrected, and what was corrected can be told, kept and used again."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from lfref.captures.alignment import ALIGNMENT
from lfref.captures.black_views import BLACK_VIEWS
from lfref.captures.chromatic import CHROMATIC
from lfref.captures.defect import Correction, Evidence, Finding, shape_told
from lfref.captures.exposure import EXPOSURE
from lfref.captures.hot_pixels import HOT_PIXELS
from lfref.captures.noise import NOISE
from lfref.captures.spacing import SPACING, Spacing
from lfref.captures.vignetting import VIGNETTING
from lfref.errors import FileError, InputError
from lfref.io import tensor_files
from lfref.lightfield import LightField

# PART corrections
# The defects that are looked for, in the order in which they are taken off: the reverse of the light's way.

CORRECTIONS: tuple[Correction, ...] = (
    HOT_PIXELS,
    BLACK_VIEWS,
    VIGNETTING,
    EXPOSURE,
    CHROMATIC,
    ALIGNMENT,
    SPACING,
    NOISE,
)
"""Each is looked for in the field that those before it have put right; noise is told and never taken off."""


SMALLEST = 32
"""Pixels along the shorter side of views in which defects are looked for."""
FORMAT = "lfref corrections 1"


@dataclass(frozen=True, eq=False)
class Corrections:
    """What was found in a light field, in the order in which it was corrected; nothing where it shows too little."""

    grid: tuple[int, int]
    """View rows and columns of the light field."""
    size: tuple[int, int]
    """Height and width of its views in pixels."""
    findings: tuple[Finding, ...]
    """One a correction."""
    left: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """Name of a correction that is not made, whether it finds something or was not looked for -> why."""

    def __getitem__(self, name: str) -> Finding:
        return next(finding for finding in self.findings if finding.name == name)

    @property
    def active(self) -> tuple[str, ...]:
        """Names of those that changed something."""
        return tuple(finding.name for finding in self._made())

    def explain(self) -> str:
        """What was found and done, a line a correction."""
        said = {finding.name: _told(finding) for finding in self.findings}
        said |= {name: f"left: {why}" for name, why in self.left.items()}
        return "\n".join(f"{name:12} {text}" for name, text in said.items())

    def leaving(self, left: Mapping[str, str]) -> "Corrections":
        """The same, but some of them are not made.

        Args:
            left: Name -> why.
        """
        return dataclasses.replace(self, left={**self.left, **left})

    def apply(self, field: LightField) -> LightField:
        """Correct a light field by what was found, in it or in another one of the same camera.

        Args:
            field: Of the same grid and size; what measures and scales light is left where it holds encoded samples.

        Raises:
            InputError: Another grid or size.
        """
        if (field.grid, field.size) != (self.grid, self.size):
            (n_rows, n_columns), (height, width) = self.grid, self.size
            expected = f"the corrections are of {n_rows}x{n_columns} views of {height}x{width} pixels"
            raise InputError(expected, got=shape_told(field))
        for finding in self.leaving(_without_light(field))._made():
            field = finding.corrected(field)
        return field

    def save(self, path: str | Path) -> None:
        """Write a file that `load` reads.

        Args:
            path: File to write or replace.

        Raises:
            FileError: It cannot be written.
        """
        found = {finding.name: _plain(finding) for finding in self.findings if finding.inert() is None}
        tensor_files.write_checkpoint(path, {"format": FORMAT, "grid": self.grid, "size": self.size, "findings": found})

    def _made(self) -> list[Finding]:
        return [finding for finding in self.findings if finding.inert() is None and finding.name not in self.left]


def correct(
    field: LightField, white: LightField | None = None, profile: Corrections | str | Path | None = None
) -> tuple[LightField, Corrections]:
    """Take off the defects that a light field shows, and no others.

    Args:
        field: A capture, or any light field. Of encoded samples (`encoding=none`) only places, black views and hot
            pixels are looked at: what measures and scales light needs light.
        white: A picture of a white scene by the same camera, of the same grid and size.
        profile: What was found in another capture of the camera, or a file of that: applied as it is, nothing is looked
            for.

    Returns:
        The light field, itself where all corrections are inert, and what was found.

    Raises:
        InputError: A white picture or a profile of another grid or size, both of them, or a white picture of encoded
            samples.
        FileError: The profile cannot be read.

    Example:
        >>> field = lfref.LightField(torch.full((5, 5, 3, 64, 80), 0.5))
        >>> mended, found = lfref.correct(field)
        >>> mended is field, found.active
        (True, ())
    """
    if profile is not None and white is not None:
        expected = "corrections are looked for, by a white picture if there is one, or known from another capture"
        raise InputError(expected, got="a white picture and a profile", remedy="leave one of them out")
    if profile is not None:
        known = profile if isinstance(profile, Corrections) else load(profile)
        return known.apply(field), known.leaving(_without_light(field))
    return looked(Evidence(field, white))


def looked(evidence: Evidence) -> tuple[LightField, Corrections]:
    """As `correct`, of a light field at which somebody has looked already.

    Args:
        evidence: What is known of it.
    """
    field, findings = evidence.field, list[Finding]()
    left = _blind(field) or _without_light(field)
    for correction in (each for each in CORRECTIONS if each.kind.name not in left):
        findings.append(finding := correction.find(evidence))
        if finding.inert() is None:
            evidence = Evidence(finding.corrected(evidence.field), evidence.white)
    return evidence.field, Corrections(field.grid, field.size, tuple(findings), left)


def _blind(field: LightField) -> dict[str, str]:
    """Corrections that are not looked for because there is too little in a light field, all or none, and why."""
    # Extremes are NaN where any sample is, and are found in a third of the time of `isfinite`.
    is_finite = all(bool(extreme.isfinite()) for extreme in field.views.aminmax())
    reasons = {
        f"views are smaller than {SMALLEST} pixels": min(field.size) < SMALLEST,
        "one view has none to be compared with": field.grid == (1, 1),
        "views hold NaN or infinity": not is_finite,
    }
    return {each.kind.name: why for why, holds in reasons.items() if holds for each in CORRECTIONS}


def _without_light(field: LightField) -> dict[str, str]:
    """Corrections that samples of a light field do not allow because they are encoded, and why."""
    why = "encoded samples are no light (reader.encoding=none)"
    return {} if field.is_linear else {each.kind.name: why for each in CORRECTIONS if each.needs_light}


def load(path: str | Path) -> Corrections:
    """Read what `Corrections.save` wrote.

    Args:
        path: The file.

    Raises:
        FileError: It is missing, damaged or no such file.
    """
    content = _content(Path(path))
    kinds = {correction.kind.name: correction.kind for correction in CORRECTIONS}
    try:
        found = tuple(kinds[name](**fields) for name, fields in content["findings"].items())
        return Corrections(tuple(content["grid"]), tuple(content["size"]), found)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _alien(path, f"entries that are not understood ({error})") from error


def _content(path: Path) -> Mapping[str, Any]:
    if not path.is_file():
        raise FileError(f"no corrections at {path}", remedy="give a file that correct=auto wrote, correction.pt")
    try:
        content = torch.load(path, weights_only=True, map_location="cpu")
    except Exception as error:  # whatever a damaged archive makes torch say
        raise _alien(path, "another kind of file, or a damaged one") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise _alien(path, "a file of something else")
    return content


def _alien(path: str | Path, got: str) -> FileError:
    return FileError(f"{path} must hold corrections", got=got, remedy="give a file that correct=auto wrote")


def _plain(finding: Finding) -> dict[str, Any]:
    fields = dataclasses.fields(finding)  # type: ignore[arg-type]
    return {field.name: getattr(finding, field.name) for field in fields}


def _told(finding: Finding) -> str:
    reason = finding.inert()
    return f"corrected: {finding.told()}" if reason is None else f"left: {reason}"


# PART asked
# Light fields as somebody wants them: put right, left as they are, or corrected by what another capture showed.

AUTO, NONE = "auto", "none"


def as_asked(
    field: LightField, wanted: str, white: LightField | None = None, even: str | None = None
) -> tuple[LightField, Corrections | None]:
    """A light field as it is to be used, and what was corrected; None where nothing was looked for.

    Args:
        field: As it was read.
        wanted: `auto`, `none`, or a file that `Corrections.save` wrote.
        white: A picture of a white scene by the same camera.
        even: Why cameras must stay on an even grid, so that their spacing is told and not corrected; None: they need
            not.

    Raises:
        InputError: A white picture or corrections of another grid or size.
        FileError: The file of corrections cannot be read.
    """
    if wanted == NONE:
        return field, None
    made, found = correct(field, white, None if wanted == AUTO else wanted)
    if even is None or made.positions is field.positions:
        return made, found
    found = found.leaving({Spacing.name: f"{found[Spacing.name].told()}, but {even}"})
    return dataclasses.replace(made, positions=field.positions), found
