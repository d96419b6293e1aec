"""Large light fields, refocused in bands of rows: the same pictures to the bit, in the memory that a band takes."""

import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.io.scratch import Room
from lfref.lightfield import LightField
from lfref.refocuser.refocuser import Refocuser


def in_bands(
    refocuser: Refocuser, field: LightField, slopes: Tensor, n_rows: int, room: Room, device: torch.device
) -> Tensor:
    """The stack of a light field that may be larger than memory.

    Args:
        refocuser: One whose pixels depend on the samples around them and no others.
        field: Its views may lie on a disk.
        slopes: Of the planes, in pixels per view step, float64, [N].
        n_rows: Rows of pixels of a band, at least 1.
        room: Where the stack shall lie.
        device: Where bands are refocused.

    Returns:
        Float32, on the CPU, [N, C, H, W].

    Raises:
        InputError: A method that looks at the whole picture, or slopes that it cannot use.
    """
    reach = refocuser.reach(slopes, field)
    if reach is None:
        what = f"{refocuser.name} of samples with weights" if field.weight is not None else refocuser.name
        raise InputError(
            "bands are for methods whose pixels depend on those around them",
            got=f"{what}, which looks at the whole picture",
            remedy="take method=shift_and_sum, shift_and_sum_cubic or shift_and_sum_cubic_fill, or leave rows out",
        )
    height, width = field.size
    n_read = min(height, n_rows + 2 * reach)
    stack = torch.from_numpy(room((len(slopes), field.views.shape[2], height, width), "float32"))
    for first in range(0, height, n_rows):
        last = min(first + n_rows, height)
        top = min(max(first - reach, 0), height - n_read)
        band = field.crop(top, 0, n_read, width).to(device)
        stack[:, :, first:last] = refocuser(band, slopes)[:, :, first - top : last - top].cpu()
    return stack
