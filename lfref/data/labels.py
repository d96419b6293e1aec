"""Label sources: a refocusing operator, or a photograph of the scene, with the focal planes that labels are made for.

Patches are cut with a margin around them, so that a local operator (shift-and-sum) labels a patch exactly as it
labels the whole field. A Fourier slice depends on every pixel of what it is given, so its patch labels differ from
those of the whole field by the ringing of the crop's own border; `docs/refocusing.md` states by how much.
"""

import math
from dataclasses import dataclass

from torch import Tensor

from lfref import geometry
from lfref.data.sources import SimulatedField
from lfref.errors import InputError
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


@dataclass(frozen=True)
class RenderedLabels:
    """Photographs the refocused stack that a network should learn: what a lens with the whole aperture records."""

    name: str
    """As tables and legends call it."""
    planes: FocalPlanes
    """The planes of a label."""

    def margin(self, grid: tuple[int, int]) -> int:
        """No pixel around a patch is needed: its label is cut from the photograph of the whole field.

        Args:
            grid: Number of view rows and columns (V, U).
        """
        return 0

    def __call__(self, field: LightField) -> Tensor:
        """Photograph a light field's scene.

        Args:
            field: The light field, of a simulated scene.

        Returns:
            Stack in the brightness and colours of the views, in [0, 1], [N, C, H, W].

        Raises:
            InputError: The scene is not known, or its views are too small for these planes.
        """
        if not isinstance(field, SimulatedField):
            raise InputError(
                "rendered labels need light fields of simulated scenes",
                got=field.name,
                remedy="use data=simulated, or label=shift_and_sum",
            )
        return field.photograph(tuple(self.planes.slopes.tolist()))


Labels = LabelSource | RenderedLabels
"""What makes labels: has `name`, `planes`, `margin`, and is called with a light field."""
