"""What a refiner reads of each plane: a classical picture of it, and what tells where that picture errs.

Every guide is one entry of a table, made of the light field and the slopes alone, so that any view grid, any planes and
any number of them serve.
Letters: `N` planes, `C H W` channel, pixel row and column, `s` slope, `d` disparity.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from lfref.errors import chosen
from lfref.lightfield import LightField
from lfref.refocus.focus.disparity import disparity_map
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.operators import OperatorRefocuser
from lfref.refocuser.refocuser import Refocuser

POINTS = OperatorRefocuser("points", functools.partial(shift_and_sum, interpolation="cubic"))
"""The plain sum of the views, which the other guides are measured by."""


@dataclass(frozen=True, eq=False)
class Seen:
    """A light field and planes of it, with what several guides share, each found when first asked for."""

    light: LightField
    """On an even grid."""
    slopes: Tensor
    """In pixels per view step, float64, [N]."""
    base: Refocuser
    """Makes the classical pictures."""

    @cached_property
    def pictures(self) -> Tensor:
        """The classical pictures, [N, C, H, W]."""
        return self.base(self.light, self.slopes)

    @cached_property
    def sums(self) -> Tensor:
        """Plain sums of the views, [N, C, H, W]."""
        return self._summed(self.light)

    @cached_property
    def spread(self) -> Tensor:
        """Standard deviation over the views that a pixel of a plane is the sum of, colours together, [N, 1, H, W]."""
        means = self._summed(replace(self.light, views=self.light.views.square()))
        return (means - self.sums.square()).mean(1, keepdim=True).clamp(min=0).sqrt()

    @cached_property
    def defocus(self) -> Tensor:
        """How far each pixel of the central view is from each plane, s - d, [N, 1, H, W]."""
        disparity = disparity_map(self.light.views).disparity.to(self.light.views)
        return self.slopes.to(disparity)[:, None, None, None] - disparity

    @property
    def central(self) -> Tensor:
        """The view in the middle, [C, H, W]."""
        rows, columns = self.light.grid
        return self.light.views[rows // 2, columns // 2]

    def _summed(self, light: LightField) -> Tensor:
        """Through the aperture of the classical pictures, if they have one."""
        return POINTS.through(getattr(self.base, "aperture", None))(light, self.slopes)


GUIDES: dict[str, Callable[[Seen], Tensor]] = {
    "picture": lambda seen: seen.pictures - 0.5,
    "sum": lambda seen: 10 * (seen.sums - seen.pictures),
    "spread": lambda seen: 5 * seen.spread,
    "defocus": lambda seen: torch.cat([seen.defocus.tanh(), (0.3 * seen.defocus.abs()).tanh()], 1),
    "central": lambda seen: 3 * (seen.central - seen.pictures),
}
"""Each (seen) -> [N, channels, H, W], of the order of 1."""


def guides(seen: Seen, names: Sequence[str]) -> Tensor:
    """What a refiner reads of planes.

    Args:
        seen: A light field and planes of it.
        names: Of `GUIDES`.

    Returns:
        Guides one after the other, [N, channels, H, W].

    Raises:
        InputError: There is no such guide.
    """
    return torch.cat([chosen("guide", name, GUIDES)(seen) for name in names], 1)
