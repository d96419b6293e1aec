"""Pictures of whole coarse pixels: what lies beyond the edge is as what lies at it.

Letters: `H W` pixel row and column, `r` pixels along the side of a coarse one.
"""

import torch
from torch import Tensor
from torch.nn import functional as F


def whole(images: Tensor, side: int) -> Tensor:
    """Images whose rows and columns are filled up to whole coarse pixels.

    Args:
        images: [B, K, H, W].
        side: Pixels along the side of a coarse one, r.

    Returns:
        [B, K, r * ceil(H / r), r * ceil(W / r)].
    """
    if side == 1:
        return images
    # What is followed at one size is run at others.
    if torch.compiler.is_exporting() or torch.jit.is_tracing():
        return _repeated(_repeated(images, side, -1), side, -2)
    height, width = images.shape[-2:]
    beyond = (0, -width % side, 0, -height % side)
    if not any(beyond):
        return images
    # Autocast would make single precision of it.
    with torch.autocast(images.device.type, enabled=False):
        return F.pad(images, beyond, mode="replicate")


def _repeated(images: Tensor, side: int, axis: int) -> Tensor:
    """The same along one axis by operations that are alike for all lengths: as many more as may be needed, then cut."""
    length = images.shape[axis]
    last = images.narrow(axis, length - 1, 1)
    filled = torch.cat([images] + [last] * (side - 1), axis)
    return filled.narrow(axis, 0, (length + side - 1) // side * side)
