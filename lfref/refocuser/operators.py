"""Linear refocusing operators as refocusers: any planes, any grid, samples counted by their weight."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from lfref.refocus import batches
from lfref.refocus.anywhere.homography import homography, slope_homographies
from lfref.refocus.focus.all_in_focus import all_in_focus
from lfref.refocus.fourier.focal_stack_transform import focal_stack_transform
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.refocuser import Aperture, Refocuser

Operator = Callable[..., Tensor]
"""(views [..., V, U, C, H, W], slopes [N]) -> stack [..., N, C, H, W]; with an aperture, `weights` [V, U] too."""

LEAST_WEIGHT = 1e-3  # below this share of trusted samples a pixel has no colour of its own and becomes black


@dataclass(eq=False)
class OperatorRefocuser(Refocuser):
    """A linear operator, perhaps looking through an aperture.

    Args:
        name: As tables and legends call it.
        operator: Refocuses views at slopes; options already bound.
        aperture: Weights of the views, whatever their grid; None weighs all alike.

    Example:
        >>> refocuser = OperatorRefocuser("shift_and_sum", lfref.shift_and_sum)
        >>> refocuser(torch.rand(3, 3, 3, 16, 16), [-0.5, 0, 0.5]).shape
        torch.Size([3, 3, 16, 16])
    """

    name: str
    operator: Operator
    aperture: Aperture | None = None

    def stack(self, views: Tensor, weight: Tensor | None, slopes: Tensor) -> Tensor:
        """The operator's stack; with weights, the weighted mean, black where no trusted sample contributes."""
        if weight is None:
            return self._sum(views, slopes)
        radiance = batches.radiance(views)
        weight = weight.to(radiance)
        share, weighted = self._sum(weight, slopes), self._sum(radiance * weight, slopes)
        mean = torch.where(share > LEAST_WEIGHT, weighted / share.clamp(min=LEAST_WEIGHT), 0.0)
        return mean.to(batches.stack_dtype(views))

    def through(self, aperture: Aperture | None) -> "OperatorRefocuser":
        """As in `Refocuser`; an aperture of its own is kept."""
        return self if aperture is None or self.aperture is not None else replace(self, aperture=aperture)

    def _sum(self, views: Tensor, slopes: Tensor) -> Tensor:
        if self.aperture is None:
            return self.operator(views, slopes)
        return self.operator(views, slopes, weights=self.aperture(tuple(views.shape[-5:-3])))


def even_stack(views: Tensor, slopes: Tensor) -> Tensor:
    """The focal stack transform with as many planes between the same extremes.

    Args:
        views: Light fields, [..., V, U, C, H, W].
        slopes: In pixels per view step, in any order, [N].
    """
    return focal_stack_transform(views, len(slopes), float(slopes.min()), float(slopes.max()))


def coplanar_homography(views: Tensor, slopes: Tensor) -> Tensor:
    """Homographies of cameras in one plane, which shift-and-sum needs no matrices for.

    Args:
        views: Light fields, [..., V, U, C, H, W].
        slopes: In pixels per view step, [N].
    """
    return homography(views, slope_homographies(slopes, (views.shape[-5], views.shape[-4])))


def focus(views: Tensor, slopes: Tensor) -> Tensor:
    """The all-in-focus picture of a linear shift-and-sum, as a stack of one.

    Args:
        views: Light fields, [..., V, U, C, H, W].
        slopes: In pixels per view step, [N].
    """
    return all_in_focus(shift_and_sum(views, slopes)).image.unsqueeze(-4)
