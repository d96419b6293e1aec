"""Planes that span the range of slopes that a scene occupies: every capture gets its own."""

from dataclasses import dataclass

from lfref import geometry
from lfref.captures.evidence import Evidence
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus.focus import slope_range

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
