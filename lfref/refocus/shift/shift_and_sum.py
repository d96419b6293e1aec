"""Shift-and-sum refocusing: the mean over the aperture of views shifted in proportion to their position.

`I_s(x, y) = sum_uv w_uv L[v, u](x + s (u - u0), y + s (v - v0)) / sum_uv w_uv`, over views that have a sample there.
The shift is separable, so each plane takes a horizontal pass over every view row and one vertical pass. The plane may
then be seen through cells instead of points of the aperture: see `footprint`. Products with banded matrices
(`shift_bands`) compute it on any device; on the CPU compiled loops do (`shift_numba`), where no derivative is needed.
Letters: `u v` view column and row, `x y` pixel column and row, `s` slope in pixels per view step.
Source: Ng et al., "Light Field Photography with a Hand-held Plenoptic Camera", 2005, section 4.
"""

from torch import Tensor

from lfref.errors import chosen
from lfref.functional.devices import is_known, on_device
from lfref.geometry import Slopes
from lfref.refocus import batches, footprint
from lfref.refocus.sampling import BORDERS, CUBIC, INTERPOLATIONS, Border, Interpolation
from lfref.refocus.shift import shift_numba
from lfref.refocus.shift.shift_bands import sum_by_bands
from lfref.refocus.shift.shifts import Shifts, shifts_of


def shift_and_sum(
    views: Tensor,
    slopes: Slopes,
    interpolation: str = "linear",
    border: str = "renormalize",
    weights: Tensor | None = None,
    fill_factor: float = 0.0,
    disparity: float = 0.0,
    positions: Tensor | None = None,
) -> Tensor:
    """Refocus light fields at the given slopes.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        interpolation: `nearest`, `linear`, `cubic` (convolution) or `spline` (cubic splines, the sharpest).
        border: `renormalize` (only views with a sample there count), `edge`, `zero` or `wrap`.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.
        fill_factor: Side of the cell that each view stands for, in view steps, >= 0: 0 is the sum over points, 1 the
            integral over the aperture.
        disparity: Of the scene, in pixels per view step: at this slope cells do not blur.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views, [..., N, C, H, W].
        A pixel that no weighted view covers (see `coverage`) is 0.

    Raises:
        InputError: Views, slopes, weights, cells, positions or names that cannot be used.

    Example:
        >>> views = torch.rand(7, 7, 3, 48, 64)
        >>> lfref.shift_and_sum(views, [-0.5, 0, 0.5], border="edge").shape
        torch.Size([3, 3, 48, 64])
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    planes = batches.checked_slopes(slopes, grid, size, positions)
    cell = footprint.checked(fill_factor, disparity, views)
    method, rule = chosen("interpolation", interpolation, INTERPOLATIONS), chosen("border", border, BORDERS)
    aperture = batches.checked_weights(weights, grid)
    shifts = shifts_of(planes, grid, method, positions)
    widths = None if cell.fill_factor == 0 else cell.widths(planes).abs()
    return batches.restored(summed(batch, shifts, widths, aperture, method, rule), views)


def coverage(
    slopes: Slopes,
    grid: tuple[int, int],
    size: tuple[int, int],
    interpolation: str = "linear",
    weights: Tensor | None = None,
    positions: Tensor | None = None,
) -> Tensor:
    """Share of the aperture that has a sample at each pixel of each plane, in [0, 1], float64, CPU, [N, H, W].

    Views are of a grid (V, U) and a size (H, W); other arguments are as in `shift_and_sum`.
    """
    planes = batches.checked_slopes(slopes, grid, size, positions)
    method = chosen("interpolation", interpolation, INTERPOLATIONS)
    shifts, aperture = shifts_of(planes, grid, method, positions), batches.checked_weights(weights, grid)
    return shifts.coverage(aperture.reshape(shifts.rows.shape[1], -1), size, BORDERS["renormalize"])[0]


def summed(
    views: Tensor,
    shifts: Shifts,
    widths: Tensor | None,
    aperture: Tensor,
    interpolation: Interpolation,
    border: Border,
    reach: int | None = None,
) -> Tensor:
    """Shifted views [B, V, U, C, H, W] summed for planes, and blurred by boxes of widths [N]: [B, N, C, H, W].

    The aperture [V, U] is of sum 1. `reach` are the samples to each side that a box reads at most; None where the host
    knows the widths.
    """
    lines = (shifts.rows.shape[1], shifts.columns.shape[2])
    views = batches.without_unread(views, aperture).reshape(len(views), *lines, *views.shape[3:])
    aperture = aperture.reshape(lines)
    if batches.is_compiled(views) and is_known(shifts.rows):
        return shift_numba.shift_and_sum(views, shifts, widths, aperture, interpolation, border)
    if widths is not None:
        farthest = footprint.radius(float(widths.max())) if reach is None else reach
        boxes = footprint.taps(on_device(widths, views.device), farthest)
        shifts = Shifts(shifts.rows, shifts.columns, boxes)
    shifts = shifts.to(views.device)
    aperture = on_device(aperture, views.device, batches.working_dtype(views.dtype))
    return sum_by_bands(views, shifts, aperture, interpolation, border)


def sums_of(views: Tensor, slopes: Tensor) -> Tensor:
    """The sums of one light field [V, U, C, H, W] at slopes [N] that a device computes, by cubic interpolation."""
    grid = views.shape[0], views.shape[1]
    aperture = batches.checked_weights(None, grid)
    return summed(views[None], shifts_of(slopes, grid, CUBIC), None, aperture, CUBIC, BORDERS["renormalize"])[0]
