"""What matching looks at: the grey views that are to be read, one after the other, and where each stands.

Letters: `K` views that are read, `v u` view row and column from the angular centre.
"""

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.errors import InputError
from lfref.refocus import batches, lines

SAME_DISTANCE = 1.01
"""Views whose distances from the centre are within this ratio are equally near."""


class GreyViews(NamedTuple):
    """The views of one light field."""

    samples: NDArray[np.float32]
    """[K, H, W]."""
    places: NDArray[np.float32]
    """v and u of each, in view steps from the angular centre, [K, 2]."""
    middle: NDArray[np.int64]
    """Which of them are nearest to the angular centre: one, or those around it."""

    @property
    def central(self) -> Tensor:
        """The picture in the middle, [H, W]."""
        return torch.from_numpy(self.samples[self.middle].mean(0))


def grey_views(views: Tensor, aperture: Tensor, positions: Tensor | None = None) -> GreyViews:
    """The views of a light field in grey, those of weight 0 left out.

    Args:
        views: Floating point, uint8 or uint16, [V, U, C, H, W].
        aperture: Weight of each view, [V, U].
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Raises:
        InputError: Views that are not finite, or less than two that are to be read.
    """
    is_read = aperture > 0
    if int(is_read.sum()) < 2:
        raise InputError("disparity takes more than one view", got=f"{int(is_read.sum())} of a weight above 0")
    light = [batches.radiance(view).mean(0).float().cpu() for view in views.detach()[is_read.to(views.device)]]
    samples = torch.stack(light)
    if not bool(samples.isfinite().all()):
        raise InputError("views must be finite", got="NaN or infinity", remedy="mend the file, or give views weight 0")
    grid = batches.grid_and_size(views)[0]
    places = (lines.even(grid) if positions is None else lines.checked_positions(positions, grid))[is_read]
    distances = places.square().sum(1)
    nearest = (distances <= SAME_DISTANCE * float(distances.min())).nonzero()[:, 0]
    return GreyViews(samples.numpy(), places.float().numpy(), nearest.numpy())
