"""Exact Fourier refocusing: every view's 2-D spectrum times a phase ramp, summed; no 4-D transform.

`I^(k) = sum_uv w_uv L^[v, u](k) exp(2 pi i s ((u - u0) kx + (v - v0) ky))`, equal to periodic shift-and-sum with
trigonometric interpolation. Cells of the aperture (see `footprint`) are one more factor, sinc(w kx) sinc(w ky).
Letters: `u v` view column and row, `kx ky` frequency in cycles per pixel, `s` slope in pixels per view step.
"""

from torch import Tensor

from lfref.functional import fourier
from lfref.geometry import Slopes
from lfref.refocus import batches, lines
from lfref.refocus.footprint import blurring, footprint
from lfref.refocus.fourier import spectra


def exact_fourier(
    views: Tensor,
    slopes: Slopes,
    weights: Tensor | None = None,
    fill: float = 0.0,
    disparity: float | Tensor = 0.0,
    positions: Tensor | None = None,
) -> Tensor:
    """Refocus light fields exactly, the views taken as periodic.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.
        fill: Side of the cell that each view stands for, in view steps, >= 0: 0 is the sum over points, 1 the integral
            over the aperture.
        disparity: Of what is seen, in pixels per view step: at this slope cells do not blur. A number, a map [H, W], or
            one for each light field, [..., H, W].
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
    planes, cell = lines.checked_slopes(slopes, grid, size, positions), footprint.checked(fill, disparity, views)
    cameras, aperture = lines.lines(grid, positions), batches.checked_weights(weights, grid)
    ky, kx = fourier.frequencies(size[0]), fourier.half_frequencies(size[1])
    rows = fourier.shift_phases(ky, planes[:, None] * cameras.rows) * cell.responses(planes, ky)
    columns = fourier.shift_phases(kx, planes[:, None, None] * cameras.columns) * cell.responses(planes, kx)[:, None]
    views_of_lines = batch.reshape(len(batch), *cameras.shape, *batch.shape[3:])
    stack = spectra.filter_and_sum(views_of_lines, rows, columns, aperture.reshape(cameras.shape))
    return batches.restored(blurring.periodic(stack, cell, planes), views)
