"""Shift-and-sum by Fourier interpolation: a view is moved between its samples by the phases of its spectrum.

Letters: `B` light fields, `R M` lines of views and views in each, `N` planes, `C H W` channel, pixel row and column.
"""

import math

import torch
from torch import Tensor

from lfref.functional import fourier
from lfref.refocus import batches
from lfref.refocus.sampling import Border, Interpolation
from lfref.refocus.shift.shift_bands import finished
from lfref.refocus.shift.shifts import Shifts

SEAM = 16
"""Samples over which a view that is not periodic is faded into its other end before a Fourier shift: at a jump the
shifted view would ring."""


def sum_by_phases(
    views: Tensor, shifts: Shifts, aperture: Tensor, interpolation: Interpolation, border: Border
) -> Tensor:
    """Sums [B, N, C, H, W] of views [B, R, M, C, H, W], shifted and weighted by an aperture [R, M] of sum 1."""
    rows, columns = shifts.rows.tolist(), shifts.columns.tolist()
    reach = math.ceil(max(float(part.abs().max()) for part in (shifts.rows, shifts.columns))) + 1
    images = [torch.zeros_like(batches.radiance(views[:, 0, 0])) for _ in rows]
    for v, (line, weights) in enumerate(zip(views.unbind(1), aperture, strict=True)):
        row, pad = _extended(batches.radiance(line) * weights[:, None, None, None], border, reach, -1)
        for image, down, across in zip(images, rows, columns, strict=True):
            row_sum = torch.zeros_like(image)
            for view, shift in zip(row.unbind(1), across[v if len(across) > 1 else 0], strict=True):
                _add(row_sum, view, pad, shift, border, -1)
            _add(image, *_extended(row_sum, border, reach, -2), down[v], border, -2)
    return finished(torch.stack(images, 1), shifts, aperture, border)


def _extended(views: Tensor, border: Border, reach: int, axis: int) -> tuple[Tensor, int]:
    """Views [..., H, W] continued along axis -1 or -2 as far as shifts reach, and the samples put before them."""
    if border.is_periodic:
        return views, 0
    # Both ends are faded into each other: where the transform starts over, a jump would ring across the view.
    pad = reach + SEAM
    rows = border.extend(views, pad, axis).movedim(axis, -1).clone()
    fade = 0.5 - 0.5 * torch.cos(torch.linspace(0, torch.pi, 2 * SEAM + 2, dtype=torch.float64))[1:-1]
    before, after = rows[..., -SEAM - 1 :][..., :1], rows[..., SEAM : SEAM + 1]
    seam = before + (after - before) * fade.to(rows)
    rows[..., -SEAM:], rows[..., :SEAM] = seam[..., :SEAM], seam[..., SEAM:]
    return rows.movedim(-1, axis), pad


def _add(total: Tensor, extended: Tensor, pad: int, shift: float, border: Border, axis: int) -> None:
    """Add a view, `extended` by `pad` samples and read at x + shift, onto the samples of `total` that it counts for."""
    start, stop = border.span(shift, total.shape[axis])
    length = extended.shape[axis]
    phases = fourier.shift_phases(fourier.half_frequencies(length), torch.tensor(shift, dtype=torch.float64))
    factors = torch.complex(*phases).to(extended.device, fourier.complex_dtype(extended.dtype))
    spectrum = torch.fft.rfft(extended, dim=axis) * (factors if axis == -1 else factors[:, None])
    moved = torch.fft.irfft(spectrum, n=length, dim=axis).narrow(axis, pad + start, stop - start)
    total.narrow(axis, start, stop - start).add_(moved)
