"""Whole views shifted by fractions of a pixel along one axis: by a few taps, or in the Fourier domain.

A view is read at x + shift, and added onto a running sum, so that nothing is stored twice.
"""

import torch
from torch import Tensor

from lfref.functional import fourier
from lfref.refocus.shift.task import Task

SEAM = 16  # samples over which a view that is not periodic is faded into its other end before a Fourier shift


def extended(views: Tensor, task: Task, axis: int) -> tuple[Tensor, int]:
    """The views with what lies beyond their edges, as far as the task's shifts read.

    Args:
        views: Images [..., H, W].
        task: How they are read.
        axis: -1 (columns) or -2 (rows).

    Returns:
        The extended views, and how many samples were put before them.
    """
    if task.interpolation.weights is not None:
        return task.border.extend(views, task.reach, axis), task.reach
    if task.border.is_periodic:
        return views, 0
    pad = task.reach + SEAM
    return _faded(task.border.extend(views, pad, axis).movedim(axis, -1)).movedim(-1, axis), pad


def add(total: Tensor, extended: Tensor, pad: int, shift: float, task: Task, axis: int) -> None:
    """Add a shifted view, cut back to the samples that count, onto a running sum.

    Args:
        total: Added to in place, [..., H, W].
        extended: The view with `pad` more samples before it, as `extended` makes it.
        pad: As `extended` says.
        shift: In samples.
        task: How it is read.
        axis: -1 (columns) or -2 (rows).
    """
    start, stop = task.span(shift, axis)
    part = total.narrow(axis, start, stop - start)
    if task.interpolation.weights is None:
        part.add_(_shifted(extended, shift, axis).narrow(axis, pad + start, stop - start))
        return
    for offset, weight in task.interpolation.taps(shift):
        # A weight of 0 must not touch its sample: at whole shifts it need not exist, and 0 * inf is NaN.
        if weight != 0:
            part.add_(extended.narrow(axis, pad + offset + start, stop - start), alpha=weight)


def _faded(extended: Tensor) -> Tensor:
    """Both ends of rows faded into each other: where the transform starts over, a jump would ring across the view."""
    extended = extended.clone()
    fade = 0.5 - 0.5 * torch.cos(torch.linspace(0, torch.pi, 2 * SEAM + 2, dtype=torch.float64))[1:-1]
    before, after = extended[..., -SEAM - 1 :][..., :1], extended[..., SEAM : SEAM + 1]
    seam = before + (after - before) * fade.to(extended)
    extended[..., -SEAM:], extended[..., :SEAM] = seam[..., :SEAM], seam[..., SEAM:]
    return extended


def _shifted(views: Tensor, shift: float, axis: int) -> Tensor:
    """Periodic views read at x + shift by trigonometric interpolation."""
    length = views.shape[axis]
    phases = fourier.shift_phases(fourier.half_frequencies(length), torch.tensor(shift, dtype=torch.float64))
    phases = phases.to(views.device, fourier.complex_dtype(views.dtype))
    spectrum = torch.fft.rfft(views, dim=axis) * (phases if axis == -1 else phases[:, None])
    return torch.fft.irfft(spectrum, n=length, dim=axis)
