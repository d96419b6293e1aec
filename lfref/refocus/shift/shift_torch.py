"""Shift-and-sum by plain PyTorch operations: on any device, differentiable, and the reference of the compiled loops.

A view is read at x + shift, by a few taps or in the Fourier domain, and added onto a running sum. It is kept for
derivatives, for `exact` interpolation and for devices without a compiled loop; see `shift_numba` for times.
Letters: `v u` view row and column.
"""

import torch
from torch import Tensor

from lfref.refocus import batches, footprint
from lfref.refocus.fourier import exact
from lfref.refocus.shift.shift_plan import Plan, Shifts

SEAM = 16
"""Samples over which a view that is not periodic is faded into its other end before a Fourier shift: at a jump the
shifted view would ring."""


def shift_and_sum(views: Tensor, plan: Plan) -> Tensor:
    """The sums of the shifted views [B, R, M, C, H, W], over the weight of those that count, [B, N, C, H, W]."""
    images = [torch.zeros_like(batches.radiance(views[:, 0, 0])) for _ in plan.planes]
    aperture = torch.tensor(plan.aperture, dtype=images[0].dtype, device=views.device)
    for v, (line, weights) in enumerate(zip(views.unbind(1), aperture, strict=True)):
        # One line of views at a time: only it is held as floating point, extended beyond its edges.
        row, pad = extended(batches.radiance(line) * weights[:, None, None, None], plan, -1)
        for image, shifts in zip(images, plan.planes, strict=True):
            row_sum = torch.zeros_like(image)
            for view, shift in zip(row.unbind(1), shifts.columns[v if len(shifts.columns) > 1 else 0], strict=True):
                add(row_sum, view, pad, shift, plan, -1)
            beyond, pad_rows = extended(row_sum, plan, -2)
            add(image, beyond, pad_rows, shifts.rows[v], plan, -2)
    return torch.stack([finished(*plane, plan) for plane in zip(images, plan.planes, strict=True)], dim=1)


def finished(total: Tensor, shifts: Shifts, plan: Plan) -> Tensor:
    """A plane's sum [..., H, W] blurred by its box, over the weight of the samples that count; may be overwritten."""
    image = footprint.boxed(total, shifts.width, plan.border)
    if not plan.border.counts_only_samples:
        return image
    covered = plan.coverage(shifts)
    blurred = footprint.boxed(covered, shifts.width, plan.border)
    return image.mul_(footprint.inverse(covered, blurred).to(image))


def extended(views: Tensor, plan: Plan, axis: int) -> tuple[Tensor, int]:
    """Views [..., H, W] continued along axis -1 or -2 as far as the shifts read, and the samples put before them."""
    if plan.interpolation.weights is not None:
        return plan.border.extend(views, plan.reach, axis), plan.reach
    if plan.border.is_periodic:
        return views, 0
    # Both ends are faded into each other: where the transform starts over, a jump would ring across the view.
    pad = plan.reach + SEAM
    rows = plan.border.extend(views, pad, axis).movedim(axis, -1).clone()
    fade = 0.5 - 0.5 * torch.cos(torch.linspace(0, torch.pi, 2 * SEAM + 2, dtype=torch.float64))[1:-1]
    before, after = rows[..., -SEAM - 1 :][..., :1], rows[..., SEAM : SEAM + 1]
    seam = before + (after - before) * fade.to(rows)
    rows[..., -SEAM:], rows[..., :SEAM] = seam[..., :SEAM], seam[..., SEAM:]
    return rows.movedim(-1, axis), pad


def add(total: Tensor, extended: Tensor, pad: int, shift: float, plan: Plan, axis: int) -> None:
    """Add a view, `extended` by `pad` samples and read at x + shift, onto the samples of `total` that it counts for."""
    start, stop = plan.span(shift, axis)
    part = total.narrow(axis, start, stop - start)
    if plan.interpolation.weights is None:
        length = extended.shape[axis]
        phases = exact.shift_phases(exact.half_frequencies(length), torch.tensor(shift, dtype=torch.float64))
        phases = phases.to(extended.device, exact.complex_dtype(extended.dtype))
        spectrum = torch.fft.rfft(extended, dim=axis) * (phases if axis == -1 else phases[:, None])
        part.add_(torch.fft.irfft(spectrum, n=length, dim=axis).narrow(axis, pad + start, stop - start))
        return
    for offset, weight in plan.interpolation.taps(shift):
        # A weight of 0 must not touch its sample: at whole shifts it need not exist, and 0 * inf is NaN.
        if weight != 0:
            part.add_(extended.narrow(axis, pad + offset + start, stop - start), alpha=weight)
