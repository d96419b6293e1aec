"""What is known of a light field before anything is corrected: found once, when it is asked for, and shared.

Everything here is a glance at a few reduced views, and takes milliseconds.
Letters: `V U` views, `H W` pixels, `h w` reduced pixels.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from lfref.captures import brightness
from lfref.captures.brightness import Ratios
from lfref.lightfield import LightField
from lfref.refocus.focus import glance, reduced_views
from lfref.refocus.focus.glance import Glance
from lfref.refocus.focus.reduced_views import ReducedViews


@dataclass(frozen=True, eq=False)
class Evidence:
    """Facts about a light field.

    Example:
        >>> evidence = Evidence(LightField(torch.rand(5, 5, 3, 64, 80)))
        >>> evidence.disparity.shape, evidence.confidence.shape
        (torch.Size([64, 80]), torch.Size([64, 80]))
    """

    field: LightField
    """What is looked at."""
    white: LightField | None = None
    """The same camera's picture of an evenly lit white surface, if there is one."""

    @cached_property
    def reduced(self) -> ReducedViews:
        """Views on a cross through the centre, grey and small, smooth differences in brightness taken out."""
        return reduced_views.reduced(self.field.views, self.field.weight, self.field.positions)

    @cached_property
    def glance(self) -> Glance:
        """Disparity and confidence of the reduced reference view."""
        return glance.glance(self.reduced)

    @property
    def reference(self) -> tuple[int, int]:
        """Row and column of the view that the maps belong to: the central one, 7, 7 of 14x14."""
        return self.reduced.places[0]

    @cached_property
    def disparity(self) -> Tensor:
        """Of what each pixel of the reference shows, in pixels per view step, [H, W].

        Found on reduced pixels (`glance.factor` along each side) and repeated: no value lies between two surfaces.
        """
        return self._whole(self.glance.disparity)

    @cached_property
    def confidence(self) -> Tensor:
        """How sure the disparity is, [0, 1], [H, W]; above 1/2 its standard error is below .03 reduced pixels."""
        return self._whole(self.glance.confidence)

    @cached_property
    def ratios(self) -> Ratios:
        """Brightness of every view beside that of the reference, window by window."""
        return brightness.ratios(self.field, self.disparity, self.reference)

    def _whole(self, small: Tensor) -> Tensor:
        """Reduced pixels repeated; the last row and column go on to the border."""
        rows, columns = (
            (torch.arange(n) // self.glance.factor).clamp(max=most - 1)
            for n, most in zip(self.field.size, small.shape, strict=True)
        )
        return small[rows][:, columns]
