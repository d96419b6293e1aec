"""What a light field is and what is to be seen in it: range of slopes, defects, and which options would help.

Nothing is changed; everything is a glance, half a second for some fifty views of a fifth of a megapixel.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from torch import Tensor

from lfref import geometry
from lfref.captures.correct import Corrections, looked
from lfref.captures.defect import Evidence, Finding
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus.focus import slope_range

# PART auto_planes
# Planes that span the range of slopes that a scene occupies: every capture gets its own.

BLUR = 0.5  # pixels that the outermost views move against the centre from the middle plane to the ends, at least
UNKNOWN = (-1.0, 1.0)  # where nothing is to be seen, any planes are as good
HALF = 0.49  # of the views' sides: no view may move farther


@dataclass(frozen=True)
class AutoPlanes:
    """Planes an equal step apart over the scene's range of slopes.

    Example:
        >>> AutoPlanes(3).of(lfref.LightField(torch.full((5, 5, 3, 64, 64), 0.5))).values
        (-1.0, 0.0, 1.0)
    """

    n: int = 16
    """Number of planes, at least 1."""

    def __post_init__(self) -> None:
        if isinstance(self.n, bool) or not isinstance(self.n, int) or self.n < 1:
            raise InputError("planes.n must be a whole number of at least 1", got=self.n)

    def of(self, field: LightField) -> FocalPlanes:
        """The planes of a light field.

        Args:
            field: The light field; where nothing is to be seen in it, the planes run from -1 to 1.
        """
        return self.between(slope_range.slope_range(Evidence(field).glance), field)

    def between(self, ends: tuple[float, float] | None, field: LightField) -> FocalPlanes:
        """Planes between two slopes, or a little beyond: a range within which nothing changes would show one picture.

        Args:
            ends: In pixels per view step; None: unknown.
            field: What they are to be used with.
        """
        low, high = ends or UNKNOWN
        outermost = (max(field.grid) - 1) / 2
        middle, half = (low + high) / 2, max((high - low) / 2, BLUR / max(outermost, 1))
        most = min((HALF * length / max(n - 1, 1) * 2 for n, length in zip(field.grid, field.size, strict=True)))
        low, high = (min(max(end, -most), most) for end in (middle - half, middle + half))
        return geometry.even_planes(self.n, low, high)


DARK = 0.02  # of full scale: half of a well exposed photograph is brighter than four times that
SAMPLED = 50_000  # samples whose brightness is looked at


@dataclass(frozen=True, eq=False)
class Inspection:
    """What is known of a light field.

    Example:
        >>> seen = lfref.inspect(lfref.LightField(torch.full((5, 5, 3, 64, 64), 0.5), "grey"))
        >>> seen.slopes, len(seen.planes)
        (None, 16)
    """

    evidence: Evidence
    """The light field, with maps of its disparity."""
    slopes: tuple[float, float] | None
    """Range that the scene occupies, in pixels per view step, a hundredth of strays at either end left out; None where
    too little is seen well."""
    share: float
    """Part of the picture in which disparity is seen well, [0, 1]."""
    is_reversed: bool
    """Whether one axis of the views seems to run against ours."""
    middle_light: float
    """Median of all samples of the central view."""
    corrections: Corrections
    """What there is to correct, and what could not be looked for."""

    @property
    def field(self) -> LightField:
        """What was looked at."""
        return self.evidence.field

    @property
    def disparity(self) -> Tensor:
        """Of what each pixel of the central view shows, in pixels per view step, [H, W]."""
        return self.evidence.disparity

    @property
    def confidence(self) -> Tensor:
        """How sure that is, [0, 1], [H, W]."""
        return self.evidence.confidence

    @cached_property
    def planes(self) -> FocalPlanes:
        """Sixteen planes that span the range, as `planes=auto` takes them."""
        return AutoPlanes().between(self.slopes, self.field)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Of each correction, in their order, whether it finds something or not."""
        return self.corrections.findings

    @property
    def defects(self) -> tuple[Finding, ...]:
        """The findings that there is something to correct of."""
        return tuple(finding for finding in self.findings if finding.inert() is None)

    def finding(self, name: str) -> Finding | None:
        """What the correction of that name found; None if there is no such correction."""
        return next((finding for finding in self.findings if finding.name == name), None)

    def advice(self) -> list[str]:
        """Options that would help, each with its reason, in one line."""
        said = []
        if self.is_reversed:
            said.append("rows and columns of views disagree about near and far: try reader.reverse_v=true")
        if _looks_linear(self.field, self.middle_light):
            said.append(f"half of the light is below {self.middle_light:.1%}: if too dark, try reader.encoding=linear")
        if self.slopes is None:
            said.append("nothing is seen to move between views: check reader.views, or name planes, slopes=[-1,0,1]")
        if self.defects:
            said.append("lfref refocus takes the defects off unless told not to, correct=none")
        return said

    def told(self) -> list[str]:
        """All of it in lines for people, words and figures of each in two columns."""
        return [f"{name:<12} {text}" for name, text in self._rows()]

    def as_dict(self) -> dict[str, Any]:
        """Plain containers, as JSON holds them."""
        field = self.field
        return {
            "name": field.name,
            **field.metadata,
            "grid": list(field.grid),
            "size": list(field.size),
            "channels": field.views.shape[2],
            "slopes": None if self.slopes is None else list(self.slopes),
            "share_seen_well": self.share,
            "planes": list(self.planes.values),
            "is_reversed": self.is_reversed,
            "median_light": self.middle_light,
            "left": dict(self.corrections.left),
            "findings": {each.name: {"inert": each.inert(), "told": each.told()} for each in self.findings},
            "advice": self.advice(),
        }

    def _rows(self) -> list[tuple[str, str]]:
        field, planes = self.field, self.planes.values
        kind = {name: field.metadata[name] for name in ("format", "bits", "encoding") if name in field.metadata}
        rows = [
            ("name", field.name),
            ("form", ", ".join(f"{name} {value}" for name, value in kind.items()) or "unknown"),
            ("views", f"{field.grid[0]}x{field.grid[1]} of {field.size[0]}x{field.size[1]}x{field.views.shape[2]}"),
            ("slopes", self._range()),
            ("planes", f"{len(planes)} from {planes[0]:.3g} to {planes[-1]:.3g} (planes=auto)"),
        ]
        rows += [(each.name, each.inert() or each.told()) for each in self.findings]
        rows += [(name, f"not looked for: {why}") for name, why in self.corrections.left.items()]
        return rows + [("try", text) for text in self.advice()]

    def _range(self) -> str:
        if self.slopes is None:
            return "unknown: too little is seen to move"
        low, high = self.slopes
        return f"{low:.3g} to {high:.3g} px per view step ({self.share:.0%} of the picture seen well)"


def inspect(field: LightField, white: LightField | None = None) -> Inspection:
    """Look at a light field.

    Args:
        field: The light field.
        white: The same camera's picture of an evenly lit white surface, of the same grid and size.

    Returns:
        What is known of it.

    Raises:
        InputError: A white picture of another grid or size, or of encoded samples beside linear light.

    Example:
        >>> seen = lfref.inspect(lfref.LightField(torch.rand(5, 5, 3, 64, 80)))
        >>> seen.disparity.shape, seen.is_reversed
        (torch.Size([64, 80]), False)
    """
    evidence = Evidence(field, white)
    well_seen = slope_range.on_surfaces(evidence.glance)
    return Inspection(
        evidence,
        slope_range.slope_range(evidence.glance),
        float(well_seen.float().mean()),
        slope_range.seems_reversed(evidence.reduced),
        _middle_light(evidence),
        looked(evidence)[1],
    )


def _middle_light(evidence: Evidence) -> float:
    central = evidence.field.views[evidence.reference].flatten()
    return float(central[:: max(1, central.numel() // SAMPLED)].float().nan_to_num().median())


def _looks_linear(field: LightField, middle_light: float) -> bool:
    """Whether a picture of 8 or 16 bits came out so dark that it was probably linear before it was decoded."""
    return field.metadata.get("encoding") == "srgb" and middle_light < DARK
