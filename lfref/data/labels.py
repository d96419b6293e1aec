"""Who makes labels for given focal planes: a refocusing operator, or a photograph of the scene.

Crops have a margin, so that a local operator labels a patch exactly as it labels the whole field. A Fourier slice
depends on every pixel, so its patch labels differ by ringing; `docs/refocusing.md` states by how much.
"""

import math
from dataclasses import dataclass

from torch import Tensor

from lfref import geometry
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus import footprint
from lfref.refocuser.refocuser import Refocuser


@dataclass(frozen=True)
class OperatorLabels:
    """Labels made by a refocuser, named after it; other makers of labels have the same names."""

    refocuser: Refocuser
    planes: FocalPlanes

    @property
    def name(self) -> str:
        """Name of the labels in tables and legends."""
        return self.refocuser.name

    def margin(self, grid: tuple[int, int]) -> int:
        """Pixels around a patch that its label depends on: the outermost shift, interpolation, the blur of a cell."""
        slopes = self.planes.slopes
        return math.ceil(geometry.corner_shift(slopes, grid)) + 1 + footprint.radius(self.refocuser.cell_width(slopes))

    def __call__(self, light: LightField) -> Tensor:
        """The label of a light field, [N, C, H, W], on its device."""
        return self.refocuser(light, self.planes.slopes)


@dataclass(frozen=True)
class RenderedLabels:
    """Labels that are photographs of simulated scenes through the whole aperture; the data hold them already."""

    name: str
    planes: FocalPlanes

    def margin(self, grid: tuple[int, int]) -> int:
        """0, since a label is cut from the photograph of the whole field."""
        return 0
