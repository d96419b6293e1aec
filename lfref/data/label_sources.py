"""Sources of labels for given focal planes: a refocusing operator, or a photograph of the scene.

Patches are cut with a margin, so that a local operator (shift-and-sum) labels a patch exactly as it labels the whole
field. A Fourier slice depends on every pixel of its input, so its patch labels differ from those of the whole field by
ringing from the border of the crop; `docs/refocusing.md` states by how much.
"""

import abc
import math
from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from lfref import geometry
from lfref.data.field_sources import SimulatedField
from lfref.errors import InputError
from lfref.functional import fft_lengths
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus import footprint
from lfref.refocuser.refocuser import Refocuser


class Labels(abc.ABC):
    """Source of the refocused stack that a network should learn."""

    name: str
    """Name of the labels in tables and legends."""
    planes: FocalPlanes
    """The planes of a label."""
    reads_views: ClassVar[bool] = False
    """Whether a label is computed from views alone, so that it can be made wherever they are."""

    @abc.abstractmethod
    def margin(self, grid: tuple[int, int]) -> int:
        """Pixels around a patch that its label depends on, for (V, U) view rows and columns."""

    def crop_length(self, least: int) -> int:
        """Side of a crop in pixels, at least `least`, at which its label takes the least time."""
        return least

    @abc.abstractmethod
    def __call__(self, field: LightField) -> Tensor:
        """The label of a light field, [N, C, H, W]."""

    def window(self, field: LightField, rows: slice, columns: slice) -> Tensor:
        """A window of the label, [N, C, h, w]."""
        return self(field)[..., rows, columns]


@dataclass(frozen=True)
class OperatorLabels(Labels):
    """Labels made by a refocuser that depends on a patch and a margin around it only."""

    reads_views = True
    refocuser: Refocuser
    """Refocuser that computes the labels; their name is its name."""
    planes: FocalPlanes
    """The planes of a label."""

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name of the labels in tables and legends."""
        return self.refocuser.name

    def margin(self, grid: tuple[int, int]) -> int:
        """Sum, in pixels, of the outermost view's shift, one pixel for interpolation, and the blur of a view's cell."""
        slopes = self.planes.slopes
        return math.ceil(geometry.corner_shift(slopes, grid)) + 1 + footprint.radius(self.refocuser.cell_width(slopes))

    def crop_length(self, least: int) -> int:
        """A length at which FFTs are fast, unless the refocuser is local: 240 pixels take half the time of 236."""
        return least if self.refocuser.is_local else fft_lengths.next_fast_even(least)

    def __call__(self, field: LightField) -> Tensor:
        """The refocuser's stack, with weighted samples."""
        return self.refocuser(field, self.planes.slopes)

    def window(self, field: LightField, rows: slice, columns: slice) -> Tensor:
        """As in `Labels`, without the rest where the refocuser can leave it out."""
        return self.refocuser.window(field, self.planes.slopes, rows, columns)


@dataclass(frozen=True)
class RenderedLabels(Labels):
    """Labels that are photographs through the whole aperture."""

    reads_views = False
    name: str
    """Name of the labels in tables and legends."""
    planes: FocalPlanes
    """The planes of a label."""

    def margin(self, grid: tuple[int, int]) -> int:
        """0, since a label is cut from the photograph of the whole field."""
        return 0

    def __call__(self, field: LightField) -> Tensor:
        """Photograph a simulated field's scene, in the brightness and colours of its views, in [0, 1]."""
        if not isinstance(field, SimulatedField):
            expected, remedy = "rendered labels need light fields of simulated scenes", "use data=simulated"
            raise InputError(expected, got=field.name, remedy=f"{remedy}, or label=shift_and_sum")
        return field.photograph(self.planes.values)
