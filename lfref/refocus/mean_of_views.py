"""The mean of the views: no refocusing at all, and so the rival of every network."""

from torch import Tensor

from lfref import geometry
from lfref.geometry import Slopes
from lfref.refocus.shift.shift_and_sum import shift_and_sum


def mean_of_views(
    views: Tensor, slopes: Slopes, weights: Tensor | None = None, positions: Tensor | None = None
) -> Tensor:
    """The same picture for every plane, [..., N, C, H, W]: the mean of the views, which is right at slope 0 only."""
    mean = shift_and_sum(views, [0.0], "nearest", weights=weights)
    return mean.repeat_interleave(len(geometry.as_slopes(slopes)), -4)
