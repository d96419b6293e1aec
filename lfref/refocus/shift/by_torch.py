"""Shift-and-sum by plain PyTorch operations: on any device, differentiable, and what compiled loops must equal.

Letters: `v u` view row and column.
"""

import torch
from torch import Tensor

from lfref.refocus import batches
from lfref.refocus.footprint import by_torch as boxes
from lfref.refocus.shift import shifting
from lfref.refocus.shift.task import Shifts, Task


def shift_and_sum(views: Tensor, task: Task) -> Tensor:
    """The sums of the shifted views, over the weight of those that count.

    Args:
        views: Light fields, [B, V, U, C, H, W].
        task: What is to be summed.

    Returns:
        Stacks, float32 (float64 for such views), [B, N, C, H, W].
    """
    images = [torch.zeros_like(batches.radiance(views[:, 0, 0])) for _ in task.planes]
    aperture = torch.tensor(task.aperture, dtype=images[0].dtype, device=views.device)
    for v, (view_row, weights) in enumerate(zip(views.unbind(1), aperture, strict=True)):
        # One view row at a time: only it is held as floating point, extended beyond its edges.
        row, pad = shifting.extended(batches.radiance(view_row) * weights[:, None, None, None], task, -1)
        for image, shifts in zip(images, task.planes, strict=True):
            row_sum = torch.zeros_like(image)
            for view, shift in zip(row.unbind(1), shifts.along_row(v), strict=True):
                shifting.add(row_sum, view, pad, shift, task, -1)
            beyond, pad_rows = shifting.extended(row_sum, task, -2)
            shifting.add(image, beyond, pad_rows, shifts.rows[v], task, -2)
    return torch.stack([finished(*each, task) for each in zip(images, task.planes, strict=True)], dim=1)


def finished(total: Tensor, shifts: Shifts, task: Task) -> Tensor:
    """A plane's sum as seen through the views' cells, over the weight of the samples that count; may be overwritten.

    Args:
        total: [..., H, W].
        shifts: Of the plane.
        task: What is to be summed.
    """
    image = boxes.boxed(total, shifts.width, task.border)
    return image.mul_(task.factors(shifts).to(image)) if task.border.counts_only_samples else image
