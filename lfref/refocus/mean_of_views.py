"""The mean of the views: no refocusing at all, and so the rival of every network."""

import torch
from torch import Tensor

from lfref import geometry
from lfref.geometry import Slopes
from lfref.refocus import batches


def mean_of_views(
    views: Tensor, slopes: Slopes, weights: Tensor | None = None, positions: Tensor | None = None
) -> Tensor:
    """The same picture for every plane: the mean of the views, which is right at slope 0 only.

    Args:
        views: Radiance, floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Of the planes, whose number counts, [N].
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.
        positions: Not read.

    Returns:
        Stacks, type (float32 for integers) and device of the views, [..., N, C, H, W].

    Raises:
        InputError: Views, slopes or weights that cannot be used.
    """
    batch = batches.flattened(views)
    aperture = batches.checked_weights(weights, batches.grid_and_size(batch)[0])
    factors = aperture.to(views.device, batches.working_dtype(views.dtype))
    # A row at a time, since integer views become floating point.
    rows = zip(batches.without_unread(batch, aperture).unbind(1), factors, strict=True)
    means = [torch.einsum("buchw,u->bchw", batches.radiance(row), of_row) for row, of_row in rows]
    mean = torch.stack(means, 1).sum(1, keepdim=True)
    return batches.restored(mean.repeat(1, len(geometry.as_slopes(slopes)), 1, 1, 1), views)
