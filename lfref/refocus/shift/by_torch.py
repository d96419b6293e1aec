"""Shift-and-sum by plain PyTorch operations: on any device, differentiable, and what compiled loops must equal.

Letters: `v u` view row and column.
"""

import torch
from torch import Tensor

from lfref.refocus import batches
from lfref.refocus.shift.task import Task


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
        extended, pad = _extended(batches.radiance(view_row) * weights[:, None, None, None], task, -1)
        for image, shifts in zip(images, task.planes, strict=True):
            row_sum = torch.zeros_like(image)
            for view, shift in zip(extended.unbind(1), shifts.columns, strict=True):
                _add(row_sum, view, shift, pad, task, -1)
            beyond, pad_rows = _extended(row_sum, task, -2)
            _add(image, beyond, shifts.rows[v], pad_rows, task, -2)
    if task.border.counts_only_samples:
        for image, shifts in zip(images, task.planes, strict=True):
            image.mul_(task.factors(shifts).to(image))
    return torch.stack(images, dim=1)


def _extended(views: Tensor, task: Task, axis: int) -> tuple[Tensor, int]:
    """The views with what lies beyond their edges, and how many samples were put before them."""
    return task.interpolation.extend(views, task.border, task.reach, axis)


def _add(total: Tensor, extended: Tensor, shift: float, pad: int, task: Task, axis: int) -> None:
    """Add a shifted view, cut back to its own size, onto a running sum."""
    task.interpolation.add_shifted(total, extended, shift, pad, task.span(shift, axis), axis)
