"""Exact Fourier refocusing: every view's 2-D spectrum times a phase ramp, summed; no 4-D transform.

`I^(k) = sum_uv w_uv L^[v, u](k) exp(2 pi i s ((u - u0) kx + (v - v0) ky))`, equal to periodic shift-and-sum with
trigonometric interpolation. Cells of the aperture (see `footprint`) are one more factor, sinc(w kx) sinc(w ky).
Phases are computed in float64, whatever the data are: at 500 pixels float32 phases cost three digits. The Nyquist bin
of an even size belongs to both signs of its frequency, so its phase is the mean of the two, the real part; that is what
makes the shifted signal real and the shift the trigonometric interpolation.
Letters: `u v` view column and row, `kx ky` frequency in cycles per pixel, `s` slope in pixels per view step.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from lfref.geometry import Slopes
from lfref.refocus import batches, footprint
from lfref.refocus.sampling import BORDERS


def half_frequencies(length: int) -> Tensor:
    """Frequencies of `rfft` in cycles per sample, float64, [length // 2 + 1]."""
    return torch.fft.rfftfreq(length, dtype=torch.float64)


def frequencies(length: int) -> Tensor:
    """Frequencies of `fft` in cycles per sample, float64, [length]."""
    return torch.fft.fftfreq(length, dtype=torch.float64)


def shift_phases(frequencies: Tensor, shifts: Tensor) -> Tensor:
    """Factors exp(2 pi i shift k), [..., K], from the spectrum of f(x) to that of f(x + shift); real at Nyquist."""
    angle = 2 * torch.pi * shifts[..., None] * frequencies
    return real_at_nyquist(torch.polar(torch.ones_like(angle), angle), frequencies)


def real_at_nyquist(factors: Tensor, frequencies: Tensor) -> Tensor:
    """Factors [..., K] at frequencies [K], real at the Nyquist frequency, whose bin gets the mean of both its signs."""
    return torch.complex(factors.real, torch.where(frequencies.abs() == 0.5, 0.0, factors.imag))


def complex_dtype(dtype: torch.dtype) -> torch.dtype:
    """The complex type that goes with a real one: complex128 for float64, complex64 for all others."""
    return torch.complex128 if dtype == torch.float64 else torch.complex64


def exact_fourier(
    views: Tensor,
    slopes: Slopes,
    weights: Tensor | None = None,
    fill_factor: float = 0.0,
    disparity: float | Tensor = 0.0,
    positions: Tensor | None = None,
) -> Tensor:
    """Refocus light fields exactly, the views taken as periodic.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.
        fill_factor: Side of a view's cell in view steps, >= 0, as in `shift_and_sum`.
        disparity: Of the scene, in pixels per view step, as in `shift_and_sum`.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views, [..., N, C, H, W].

    Raises:
        InputError: Views, slopes, weights, cells or positions that cannot be used.

    Example:
        >>> views = torch.rand(7, 7, 3, 48, 64)
        >>> stack = lfref.exact_fourier(views, lfref.slopes([0.5, 1, 2]))
        >>> torch.allclose(stack[1], views.mean((0, 1)), atol=1e-6)
        True
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    planes, cell = (
        batches.checked_slopes(slopes, grid, size, positions),
        footprint.checked(fill_factor, disparity, views),
    )
    cameras, aperture = batches.lines(grid, positions), batches.checked_weights(weights, grid)
    ky, kx = frequencies(size[0]), half_frequencies(size[1])
    rows = shift_phases(ky, planes[:, None] * cameras.rows) * cell.responses(planes, ky)
    columns = shift_phases(kx, planes[:, None, None] * cameras.columns) * cell.responses(planes, kx)[:, None]
    views_of_lines = batch.reshape(len(batch), *cameras.shape, *batch.shape[3:])
    stack = filter_and_sum(views_of_lines, rows, columns, aperture.reshape(cameras.shape))
    if cell.fill_factor > 0 and cell.varies:  # a constant blur is part of the spectrum
        stack = footprint.blurred(stack, cell.widths(planes), BORDERS["wrap"])
    return batches.restored(stack, views)


def filter_and_sum(
    views: Tensor, rows: Tensor, columns: Tensor, weights: Tensor, extend: Callable[[Tensor], Tensor] | None = None
) -> Tensor:
    """Sum of the filtered views, `I^(k) = sum_v R[v](ky) sum_u C[u](kx) w_uv L^[v, u](k)`, for every plane.

    Views are [B, V, U, C, H, W], weights [V, U]. `rows` [N, V, H] are at the frequencies of `fft`, `columns`
    [N, U, W // 2 + 1] at those of `rfft`, or of the views of each row, [N, V or 1, U, W // 2 + 1]. `extend` turns views
    [..., H, W] into periods of the size that the factors have; None: they are periods. Returns stacks [B, N, C, H, W].
    """
    working = batches.working_dtype(views.dtype)
    dtype = complex_dtype(working)
    rows, columns = rows.to(views.device, dtype), columns.to(views.device, dtype)
    columns = columns.unsqueeze(1) if columns.ndim == 3 else columns
    views, weights = batches.without_unread(views, weights), weights.to(views.device, working)
    shape = (views.shape[0], views.shape[3], rows.shape[-1], columns.shape[-1])
    planes = [rows.new_zeros(shape) for _ in rows]
    for v, (view_row, row_weights) in enumerate(zip(views.unbind(1), weights, strict=True)):
        # One view row at a time: its spectra are all that is held beside the planes.
        light = batches.radiance(view_row)
        periods = light if extend is None else extend(light)
        spectra = torch.fft.rfft2(periods).unbind(1)
        of_row = columns[:, v if columns.shape[1] > 1 else 0] * row_weights[:, None]
        for plane, row_factors, column_factors in zip(planes, rows[:, v], of_row, strict=True):
            total = spectra[0] * column_factors[0]
            for spectrum, factor in zip(spectra[1:], column_factors[1:], strict=True):
                total.addcmul_(spectrum, factor)
            plane.addcmul_(total, row_factors[:, None])
            del total  # so that the next sum gets the same memory, which is in the cache
    # Each spectrum is given up as its image is written: all of both together would be the peak of memory.
    size = periods.shape[-2:]
    stack = views.new_empty((views.shape[0], len(planes), views.shape[3], *size), dtype=working)
    for n in reversed(range(len(planes))):
        stack[:, n] = torch.fft.irfft2(planes.pop(), s=size)
    return stack
