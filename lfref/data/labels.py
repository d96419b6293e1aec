"""Label sources: a refocusing operator with the focal planes it makes labels for.

Patches are cut with a margin around them, so that a local operator (shift-and-sum) labels a patch exactly as it
labels the whole field. A Fourier slice depends on every pixel of what it is given, so its patch labels differ from
those of the whole field by the ringing of the crop's own border; `docs/refocusing.md` states by how much.
"""

import math
from dataclasses import dataclass

from torch import Tensor

from lfref import geometry
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus import weighted
from lfref.refocus.weighted import Operator


@dataclass(frozen=True)
class LabelSource:
    """Makes the refocused stack that a network should learn."""

    name: str
    """As tables and legends call it."""
    operator: Operator
    """Refocuses views at slopes."""
    planes: FocalPlanes
    """The planes of a label."""

    def margin(self, grid: tuple[int, int]) -> int:
        """Pixels around a patch that its label depends on, for a local operator.

        Args:
            grid: Number of view rows and columns (V, U).
        """
        return math.ceil(geometry.corner_shift(self.planes.slopes, grid)) + 1

    def __call__(self, field: LightField) -> Tensor:
        """Label a light field.

        Args:
            field: The light field, [V, U, C, H, W].

        Returns:
            Stack, [N, C, H, W].

        Raises:
            InputError: The field is too small for these planes.
        """
        return weighted.refocus(self.operator, field, self.planes.slopes)
