"""Exact Fourier refocusing: every view's 2-D spectrum times a phase ramp, summed; no 4-D transform.

`I^(k) = sum_uv w_uv L^[v, u](k) exp(2 pi i s ((u - u0) kx + (v - v0) ky))`, equal to periodic shift-and-sum with
trigonometric interpolation. Cells of the aperture (see `footprint`) are one more factor, sinc(w kx) sinc(w ky).
The Nyquist bin of an even size belongs to both signs of its frequency, so its phase is the mean of the two, the real
part; that is what makes the shifted signal real and the shift the trigonometric interpolation.
Letters: `u v` view column and row, `kx ky` frequency in cycles per pixel, `s` slope in pixels per view step.
"""

from collections.abc import Iterator

import torch
from torch import Tensor

from lfref.functional import fourier
from lfref.functional.devices import on_device
from lfref.functional.fourier import Factors, Frame, frequencies, half_frequencies, shift_phases
from lfref.geometry import Slopes
from lfref.refocus import batches, footprint
from lfref.refocus.sampling import CUBIC
from lfref.refocus.shift.shifts import shifts_of


def exact_fourier(
    views: Tensor,
    slopes: Slopes,
    weights: Tensor | None = None,
    fill_factor: float = 0.0,
    disparity: float = 0.0,
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
    shifts, device = shifts_of(on_device(planes, views.device), grid, CUBIC, positions), views.device
    ky, kx = frequencies(size[0], device), half_frequencies(size[1], device)
    rows, columns = shift_phases(ky, shifts.rows), shift_phases(kx, shifts.columns)
    if cell.fill_factor > 0:
        rows, columns = rows * cell.responses(planes, ky), columns * cell.responses(planes, kx)[:, None]
    views_of_lines = batches.without_unread(batch, aperture).reshape(len(batch), *cameras.shape, *batch.shape[3:])
    stack = filter_and_sum(views_of_lines, rows, columns, aperture.reshape(cameras.shape))
    return batches.restored(stack, views)


def filter_and_sum(
    views: Tensor, rows: Tensor, columns: Tensor, weights: Tensor | None, frame: Frame | None = None
) -> Tensor:
    """Sum of the filtered views, `I^(k) = sum_v R[v](ky) sum_u C[u](kx) w_uv L^[v, u](k)`, for every plane.

    Views are [B, V, U, C, H, W], those of weight 0 finite, weights [V, U]; None: all are 1. Factors are real and
    imaginary parts: `rows` [2, N, V, H] at the frequencies of `fft`, `columns` [2, N, U, W // 2 + 1] at those of
    `rfft`, or of the views of each row, [2, N, V or 1, U, W // 2 + 1]. `frame` are the periods in which the views lie;
    None: they are periods themselves. Returns stacks [B, N, C, H, W].
    """
    size = batches.grid_and_size(views)[1]
    lines, factors = _lines_and_factors(views, rows, columns, weights)
    sums = fourier.filtered_lines(lines, factors, frame or Frame(size, (0, 0), size))
    return sums.unflatten(1, (len(views), -1)).transpose(0, 1)


def spectra_of_sum(views: Tensor, rows: Tensor, columns: Tensor, weights: Tensor | None, frame: Frame) -> Tensor:
    """I^ of `filter_and_sum`, [B, N, C, h, w // 2 + 1]."""
    spectra = torch.cat(fourier.mixed_lines(*_lines_and_factors(views, rows, columns, weights), frame))
    return spectra.unflatten(1, (len(views), -1)).transpose(0, 1)


def _lines_and_factors(
    views: Tensor, rows: Tensor, columns: Tensor, weights: Tensor | None
) -> tuple[Iterator[Tensor], Factors]:
    """The lines of views, [U, B C, H, W] each, and their factors times the weights."""
    working = batches.working_dtype(views.dtype)
    columns = columns.unsqueeze(2) if columns.ndim == 4 else columns
    rows, columns = rows.to(working), columns.to(working)
    # [U, B C, H, W]: one line at a time is held as floating point.
    lines = (batches.radiance(line).movedim(0, 1).flatten(1, 2) for line in views.unbind(1))
    factors = [(rows[:, :, v], columns[:, :, v % columns.shape[2]]) for v in range(views.shape[1])]
    if weights is not None:
        of_views = on_device(weights, views.device, working)
        factors = [(down, across * own[:, None]) for (down, across), own in zip(factors, of_views, strict=True)]
    return lines, factors
