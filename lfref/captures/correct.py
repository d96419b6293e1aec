"""Putting a capture right: only what it shows is corrected, and what was corrected can be told, kept and used again."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from lfref.captures.correction import Finding
from lfref.captures.corrections import CORRECTIONS
from lfref.captures.evidence import Evidence
from lfref.errors import FileError, InputError
from lfref.io import tensors
from lfref.lightfield import LightField

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

    def __getitem__(self, name: str) -> Finding:
        return next(finding for finding in self.findings if finding.name == name)

    @property
    def active(self) -> tuple[str, ...]:
        """Names of those that changed something."""
        return tuple(finding.name for finding in self.findings if finding.inert() is None)

    def explain(self) -> str:
        """What was found and done, a line a correction."""
        return "\n".join(map(_line, self.findings))

    def apply(self, field: LightField) -> LightField:
        """Correct a light field by what was found, in it or in another one of the same camera.

        Args:
            field: Of the same grid and size.

        Raises:
            InputError: Another grid or size.
        """
        if (field.grid, field.size) != (self.grid, self.size):
            got = _shape_told(field.grid, field.size)
            raise InputError(f"the corrections are of {_shape_told(self.grid, self.size)}", got=got)
        for finding in self.findings:
            if finding.inert() is None:
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
        tensors.write(path, {"format": FORMAT, "grid": self.grid, "size": self.size, "findings": found})


def correct(
    field: LightField, white: LightField | None = None, profile: Corrections | str | Path | None = None
) -> tuple[LightField, Corrections]:
    """Take off the defects that a light field shows, and no others.

    Args:
        field: A capture, or any light field.
        white: A picture of a white scene by the same camera, of the same grid and size.
        profile: What was found in another capture of the camera, or a file of that: applied as it is, nothing is looked
            for.

    Returns:
        The light field, itself where all corrections are inert, and what was found.

    Raises:
        InputError: A white picture or a profile of another grid or size.
        FileError: The profile cannot be read.

    Example:
        >>> field = lfref.LightField(torch.full((5, 5, 3, 64, 80), 0.5))
        >>> mended, found = lfref.correct(field)
        >>> mended is field, found.active
        (True, ())
    """
    if profile is not None:
        known = profile if isinstance(profile, Corrections) else load(profile)
        return known.apply(field), known
    if white is not None and (white.grid, white.size) != (field.grid, field.size):
        expected = f"the white picture must be {_shape_told(field.grid, field.size)} as {field.name or 'the field'}"
        raise InputError(expected, got=_shape_told(white.grid, white.size), remedy="read both alike")
    return looked(Evidence(field, white))


def looked(evidence: Evidence) -> tuple[LightField, Corrections]:
    """As `correct`, of a light field at which somebody has looked already.

    Args:
        evidence: What is known of it.
    """
    field, findings = evidence.field, list[Finding]()
    if not _shows_enough(field):
        return field, Corrections(field.grid, field.size, ())
    for correction in CORRECTIONS:
        findings.append(finding := correction.find(evidence))
        if finding.inert() is None:
            evidence = Evidence(finding.corrected(evidence.field), evidence.white)
    return evidence.field, Corrections(field.grid, field.size, tuple(findings))


def _shows_enough(field: LightField) -> bool:
    """Whether there is enough in a light field to tell defects from what it shows."""
    if min(field.size) < SMALLEST or field.grid == (1, 1):
        return False
    # Extremes are NaN where any sample is, and are found in a third of the time of `isfinite`.
    return all(bool(extreme.isfinite()) for extreme in field.views.aminmax())


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


def _line(finding: Finding) -> str:
    reason = finding.inert()
    return f"{finding.name:12} {'corrected: ' + finding.told() if reason is None else 'left: ' + reason}"


def _shape_told(grid: tuple[int, int], size: tuple[int, int]) -> str:
    return f"{grid[0]}x{grid[1]} views of {size[0]}x{size[1]} pixels"
