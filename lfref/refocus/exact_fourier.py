"""Exact Fourier refocusing: every view's 2-D spectrum times a phase ramp, summed; no 4-D transform.

`I^(k) = sum_uv w_uv L^[v, u](k) exp(2 pi i s ((u - u0) kx + (v - v0) ky))`, equal to periodic shift-and-sum with
trigonometric interpolation. The phase is separable: a pass over the columns of views, then one over the rows.
Letters: `u v` view column and row, `kx ky` frequency in cycles per pixel, `s` slope in pixels per view step.
"""

import torch
from torch import Tensor

from lfref import geometry
from lfref.functional import fourier
from lfref.geometry import Slopes
from lfref.refocus import batches


def exact_fourier(views: Tensor, slopes: Slopes, weights: Tensor | None = None) -> Tensor:
    """Refocus light fields exactly, the views taken as periodic.

    Args:
        views: Radiance, usually in [0, 1], floating point, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.

    Returns:
        Stacks in the order of the slopes, type and device of the views, [..., N, C, H, W].

    Raises:
        InputError: Views, slopes or weights that cannot be used.
    """
    return batches.over_batches(views, lambda batch: _stack(batch, slopes, weights))


def _stack(views: Tensor, slopes: Slopes, weights: Tensor | None) -> Tensor:
    grid, size = (views.shape[1], views.shape[2]), (views.shape[-2], views.shape[-1])
    planes = geometry.checked_slopes(slopes, grid, size)
    aperture = batches.checked_weights(weights, grid).to(views)
    spectra = torch.fft.rfft2(views * aperture[:, :, None, None, None])
    vertical = fourier.shift_phases(fourier.frequencies(size[0]), planes[:, None] * geometry.angular_offsets(grid[0]))
    horizontal = fourier.shift_phases(
        fourier.half_frequencies(size[1]), planes[:, None] * geometry.angular_offsets(grid[1])
    )
    images = [
        torch.fft.irfft2(_plane(spectra, rows, columns), s=size)
        for rows, columns in zip(vertical.to(spectra), horizontal.to(spectra), strict=True)
    ]
    return torch.stack(images, dim=1)


def _plane(spectra: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Spectrum of one plane [B, C, H, W//2+1] from all views' spectra and the phases [V, H] and [U, W//2+1]."""
    image = torch.zeros_like(spectra[:, 0, 0])
    for view_row, row_phase in zip(spectra.unbind(1), rows, strict=True):
        summed = torch.zeros_like(image)
        for view, column_phase in zip(view_row.unbind(1), columns, strict=True):
            summed.addcmul_(view, column_phase)
        image.addcmul_(summed, row_phase[:, None])
    return image
