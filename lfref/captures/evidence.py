"""Facts about a light field that several corrections share, each found once, when it is first asked for."""

from dataclasses import dataclass
from functools import cached_property

from torch import Tensor

from lfref.lightfield import LightField
from lfref.refocus.focus.disparity import DisparityMap, disparity_map


@dataclass(frozen=True, eq=False)
class Evidence:
    """A light field, and what is known about it."""

    field: LightField
    white: LightField | None = None
    """A picture of a white scene by the same camera, of the field's grid and size."""

    @cached_property
    def disparity(self) -> Tensor:
        """Of each pixel of the central view, in pixels per view step, [H, W]."""
        return self._map.disparity

    @cached_property
    def confidence(self) -> Tensor:
        """How sure that is, [0, 1), [H, W]."""
        return self._map.confidence

    @cached_property
    def _map(self) -> DisparityMap:
        return disparity_map(self.field.views)
