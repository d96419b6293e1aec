"""The mean of the views: no refocusing at all, and so the rival of every network."""

import torch
from torch import Tensor

from lfref import geometry
from lfref.geometry import Slopes
from lfref.refocus import batches


def mean_of_views(
    views: Tensor, slopes: Slopes, weights: Tensor | None = None, positions: Tensor | None = None
) -> Tensor:
    """The same picture for every plane, [..., N, C, H, W]: the mean of the views, which is right at slope 0 only."""
    batch = batches.flattened(views)
    aperture = batches.checked_weights(weights, batches.grid_and_size(batch)[0])
    factors = aperture.to(views.device, batches.working_dtype(views.dtype))
    # A row at a time, since integer views become floating point.
    rows = zip(batches.without_unread(batch, aperture).unbind(1), factors, strict=True)
    means = [torch.einsum("buchw,u->bchw", batches.radiance(row), of_row) for row, of_row in rows]
    mean = torch.stack(means, 1).sum(1, keepdim=True)
    return batches.restored(mean.repeat(1, len(geometry.as_slopes(slopes)), 1, 1, 1), views)
