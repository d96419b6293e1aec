"""Shift-and-sum refocusing: the mean over the aperture of views shifted in proportion to their position.

`I_s(x, y) = sum_uv w_uv L[v, u](x + s (u - u0), y + s (v - v0)) / sum_uv w_uv`, over views that have a sample there.
The shift is separable, so each plane takes a horizontal pass over every view row and one vertical pass.
Letters: `u v` view column and row, `x y` pixel column and row, `s` slope in pixels per view step.
The plane may then be seen through cells instead of points of the aperture: see `footprint`.
Source: Ng et al., "Light Field Photography with a Hand-held Plenoptic Camera", 2005, section 4.
"""

import math

import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.geometry import Slopes
from lfref.refocus import batches, footprint, footprint_blur, lines
from lfref.refocus.sampling import BORDERS, INTERPOLATIONS
from lfref.refocus.shift import shift_torch
from lfref.refocus.shift.shift_torch import Task

BEYOND = 3
"""Samples that interpolations and the ends of boxes reach beyond a shift, at most."""


def shift_and_sum(
    views: Tensor,
    slopes: Slopes,
    interpolation: str = "linear",
    border: str = "renormalize",
    weights: Tensor | None = None,
    fill: float = 0.0,
    disparity: float | Tensor = 0.0,
    out: Tensor | None = None,
    positions: Tensor | None = None,
) -> Tensor:
    """Refocus light fields at the given slopes.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        interpolation: `nearest`, `linear`, `cubic` or `exact` (Fourier shift).
        border: `renormalize` (only views with a sample there count), `edge`, `zero` or `wrap`.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.
        fill: Side of the cell that each view stands for, in view steps, >= 0: 0 is the sum over points, 1 the integral
            over the aperture.
        disparity: Of what is seen, in pixels per view step: at this slope cells do not blur. A number, a map [H, W], or
            one for each light field, [..., H, W].
        out: A stack to write into, contiguous, with the shape, type and device of the result and memory of its own;
            None makes one. Memory that is used again saves the time to get it fresh, about a sixth of it all.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views, [..., N, C, H, W].
        A pixel that no weighted view covers (see `coverage`) is 0.

    Raises:
        InputError: Views, slopes, weights, cells, positions or names that cannot be used, or a stack that cannot be
            written into.

    Example:
        >>> views = torch.rand(7, 7, 3, 48, 64)
        >>> lfref.shift_and_sum(views, [-0.5, 0, 0.5], border="edge").shape
        torch.Size([3, 3, 48, 64])
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    planes, cell = lines.checked_slopes(slopes, grid, size, positions), footprint.checked(fill, disparity, views)
    widths = None if cell.varies(planes) else cell.widths(planes).abs().tolist()
    planned = shift_torch.plan(planes, grid, size, interpolation, border, weights, widths, positions)
    room = None if out is None else _room(out, views, len(planes))
    stack = planned_stack(batch, planned, room)
    if widths is None and cell.fill > 0:
        covered = planned.coverages if planned.border.counts_only_samples else None
        stack = footprint_blur.blurred(stack, cell.widths(planes), planned.border, covered)
    if out is None:
        return batches.restored(stack, views)
    return out if stack is room else out.copy_(batches.restored(stack, views))


def coverage(
    slopes: Slopes,
    grid: tuple[int, int],
    size: tuple[int, int],
    interpolation: str = "linear",
    weights: Tensor | None = None,
    positions: Tensor | None = None,
) -> Tensor:
    """Share of the aperture that has a sample at each pixel of each plane.

    Args:
        slopes: Focus in pixels per view step, [N].
        grid: Number of view rows and columns (V, U).
        size: Height and width (H, W) of a view in pixels.
        interpolation: As in `shift_and_sum`.
        weights: As in `shift_and_sum`.
        positions: As in `shift_and_sum`.

    Returns:
        Coverage in [0, 1], float64, CPU, [N, H, W].

    Raises:
        InputError: Slopes, weights, positions or names that cannot be used.
    """
    planned = shift_torch.plan(slopes, grid, size, interpolation, weights=weights, positions=positions)
    return planned.coverages


def reach(
    slopes: Slopes,
    grid: tuple[int, int],
    interpolation: str = "linear",
    border: str = "renormalize",
    fill: float = 0.0,
    disparity: float | Tensor = 0.0,
    positions: Tensor | None = None,
) -> int | None:
    """How many rows or columns away a sample may count for a pixel: bands of a picture that overlap by as many are as
    good as the whole.

    Args:
        slopes: Focus in pixels per view step, [N].
        grid: Number of view rows and columns (V, U).
        interpolation: As in `shift_and_sum`.
        border: As in `shift_and_sum`.
        fill: As in `shift_and_sum`.
        disparity: As in `shift_and_sum`.
        positions: As in `shift_and_sum`.

    Returns:
        Pixels; None where all samples may count: an exact interpolation, a border that wraps around, a map of
        disparities.
    """
    is_map = isinstance(disparity, Tensor) and disparity.ndim > 0
    if INTERPOLATIONS[interpolation].weights is None or BORDERS[border].is_periodic or is_map:
        return None
    planes = torch.as_tensor(slopes, dtype=torch.float64)
    farthest = max(float(offsets.abs().max()) for offsets in lines.lines(grid, positions))
    shift = float(planes.abs().max()) * farthest
    blur = fill * float((planes - float(disparity)).abs().max()) / 2
    return math.ceil(shift) + math.ceil(blur) + BEYOND


def _room(out: Tensor, views: Tensor, n_planes: int) -> Tensor:
    """A stack to write into as [B, N, C, H, W], once it is known that it can be written into."""
    shape = (*views.shape[:-5], n_planes, *views.shape[-3:])
    wanted, dtype = f"{list(shape)}, {batches.stack_dtype(views)}, contiguous", batches.stack_dtype(views)
    if out.shape != shape or out.dtype != dtype or out.device != views.device or not out.is_contiguous():
        got = f"{list(out.shape)}, {out.dtype}{'' if out.is_contiguous() else ', not contiguous'}"
        raise InputError(f"out must be {wanted}, on {views.device}", got=f"{got}, on {out.device}")
    if not (batches.is_plain(views) and batches.is_plain(out)):
        raise InputError(
            "out must not be asked for where derivatives are", remedy="leave it out, or use torch.no_grad()"
        )
    if out.untyped_storage().data_ptr() == views.untyped_storage().data_ptr():
        raise InputError("out must have memory of its own", got="that of the views")
    return out.reshape(-1, *shape[-4:])


def planned_stack(views: Tensor, planned: Task, room: Tensor | None = None) -> Tensor:
    """The stack that is planned, by loops compiled for the device where these can serve, else by PyTorch's operations.

    Args:
        views: Light fields, [B, V, U, C, H, W].
        planned: What is to be summed; its rows need not be those of the grid.
        room: Where compiled loops may write it, [B, N, C, H, W].
    """
    aperture = torch.tensor(planned.aperture)
    views = batches.without_unread(views.reshape(len(views), *aperture.shape, *views.shape[3:]), aperture)
    compiler = batches.compiler_for(views) if planned.interpolation.weights is not None else None
    # Imported here: a compiler takes half a second to load, which a program that never refocuses need not spend.
    if compiler == "numba":
        from lfref.refocus.shift import shift_numba

        return shift_numba.shift_and_sum(views, planned, room)
    if compiler == "triton" and planned.is_separable:
        from lfref.refocus.shift import shift_triton

        return shift_triton.shift_and_sum(views, planned)
    return shift_torch.shift_and_sum(views, planned)
