"""Inspecting a light field: range of slopes, planes that span it, defects, and options that would help."""

import logging
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from lfref import geometry
from lfref.captures.correct import Corrections, central_view, correct
from lfref.captures.view_order import ViewOrderDefect
from lfref.functional import noise_line
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus.focus import slope_range

log = logging.getLogger(__name__)
LEAST_BLUR = 0.5  # pixels: least shift of the outermost views at the first and last plane, the least blur that shows
UNKNOWN = (-1.0, 1.0)  # first and last plane where the range of slopes is unknown, in pixels per view step
DARK = 0.02  # median of linear light below which samples may have been linear, not sRGB
NO_SLOPES = (
    "slopes are unknown (nothing moves, or too far, or the views do not belong together): give slopes=[LOW,HIGH], or "
    "check reader.angular_size, reader.grid and reader.spacing (see lfref info)"
)


@dataclass(frozen=True)
class AutoPlanes:
    """Evenly spaced planes over the range of slopes of a scene: every capture gets its own.

    Example:
        >>> AutoPlanes(3).of(lfref.LightField(torch.full((5, 5, 3, 64, 64), 0.5))).values
        (-1.0, 0.0, 1.0)
    """

    n: int = 16

    def of(self, field: LightField) -> FocalPlanes:
        """The planes of a light field; `UNKNOWN` with a warning in the log where its range is unknown."""
        slopes = central_view(field).slopes
        if slopes is None:
            log.warning("%s: planes from %g to %g, since %s", field.name or "light field", *UNKNOWN, NO_SLOPES)
        return self.between(slopes, field)

    def between(self, ends: tuple[float, float] | None, field: LightField) -> FocalPlanes:
        """Planes from end to end, `UNKNOWN` for None. A range too narrow to change the picture is widened."""
        low, high = ends or UNKNOWN
        outermost = (max(field.grid) - 1) / 2
        middle, half = (low + high) / 2, max((high - low) / 2, LEAST_BLUR / max(outermost, 1))
        # Operators refuse slopes that move a view by half its size: .49 stays below that.
        largest = min(0.49 * length / max((n - 1) / 2, 0.5) for n, length in zip(field.grid, field.size, strict=True))
        low, high = (min(max(end, -largest), largest) for end in (middle - half, middle + half))
        return geometry.even_planes(self.n, low, high)


@dataclass(frozen=True, eq=False)
class Inspection:
    """What is known of a light field.

    Example:
        >>> inspection = lfref.inspect(lfref.LightField(torch.full((5, 5, 3, 64, 64), 0.5), "grey"))
        >>> inspection.slopes, len(inspection.planes)
        (None, 16)
    """

    field: LightField
    reference: tuple[int, int]
    """Row and column of the central view, to which the maps belong."""
    disparity: Tensor
    confidence: Tensor
    """Confidence of the disparity, [0, 1], [H, W]."""
    slopes: tuple[float, float] | None
    """Range of the scene's slopes in pixels per view step, without .5 % of outliers at either end; None: unknown."""
    confident_share: float
    """Part of the picture's textures whose disparity is reliable, [0, 1]."""
    noise: tuple[float, float]
    """Variance of a sample's noise per unit of light, and in the dark, after the corrections."""
    corrections: Corrections

    @cached_property
    def planes(self) -> FocalPlanes:
        """Sixteen planes that span the range, those of `planes=auto`."""
        return AutoPlanes().between(self.slopes, self.field)

    def advice(self) -> list[str]:
        """Options that would help, each with its reason, in one line."""
        lines = [
            f"the views focus better in another order: give {defect.remedy}"
            for defect in self.corrections.defects
            if isinstance(defect, ViewOrderDefect)
        ]
        if self.slopes is None:
            lines.append(NO_SLOPES)
        v, u = self.reference
        if self.field.metadata.get("encoding") == "srgb" and self.field.views[v, u].median() < DARK:
            lines.append("the picture is very dark: if the files hold linear light, give reader.encoding=linear")
        if self.corrections.active:
            lines.append("lfref refocus, which corrects these defects unless correct=none")
        return lines

    def lines(self) -> list[str]:
        """The inspection as lines of two columns: what the scene shows, then its defects, then advice."""
        rows, planes = self.as_dict(), self.planes.values
        defects, advice = rows.pop("defects"), rows.pop("advice")
        rows["slopes"] = "{:.3g} to {:.3g} px per view step".format(*self.slopes) if self.slopes else "unknown"
        rows["planes"] = f"{len(planes)} from {planes[0]:.3g} to {planes[-1]:.3g} (planes=auto)"
        pairs = [*rows.items(), *defects.items(), *(("try", text) for text in advice)]
        return [f"{name:<15} {text}" for name, text in pairs]

    def as_dict(self) -> dict[str, Any]:
        """The inspection in plain containers, for JSON."""
        field = self.field
        return {
            "name": field.name,
            **field.metadata,
            "grid": list(field.grid),
            "size": list(field.size),
            "channels": field.views.shape[2],
            "slopes": None if self.slopes is None else list(self.slopes),
            "confident_share": round(self.confident_share, 3),
            "planes": list(self.planes.values),
            "noise": "{:.2g} per light, {:.2g} in the dark (variance)".format(*self.noise),
            "defects": self.corrections.texts(),
            "advice": self.advice(),
        }


@torch.no_grad()
def inspect(field: LightField, flat_field: LightField | None = None) -> Inspection:
    """Inspect a light field.

    Args:
        field: The light field.
        flat_field: The same camera's picture of an evenly lit white surface, as for `correct`.

    Example:
        >>> inspection = lfref.inspect(lfref.LightField(torch.rand(5, 5, 3, 64, 80)))
        >>> inspection.disparity.shape, inspection.slopes
        (torch.Size([64, 80]), None)
    """
    corrected, corrections = correct(field, flat_field=flat_field)
    view = central_view(corrected)
    return Inspection(
        field,
        view.reference,
        view.disparity,
        view.confidence,
        view.slopes,
        slope_range.reliable_share(view.coarse),
        noise_line.measure(corrected),
        corrections,
    )
