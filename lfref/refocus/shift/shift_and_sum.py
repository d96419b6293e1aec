"""Shift-and-sum refocusing: the mean over the aperture of views shifted in proportion to their position.

`I_s(x, y) = sum_uv w_uv L[v, u](x + s (u - u0), y + s (v - v0)) / sum_uv w_uv`, over views that have a sample there.
The shift is separable, so each plane takes a horizontal pass over every view row and one vertical pass. The plane may
then be seen through cells instead of points of the aperture: see `footprint`. PyTorch's operations (`by_torch`) or
compiled loops (`shift_numba`) compute it, both by one `shift_plan`.

`shift_and_sum_antialiased` chooses cells by the scene: nearly the picture of the slow methods, at twice linear's
time. In planes beyond the disparities of the scene all is blurred, and a sum of points would show copies. There each
view stands for its whole cell: its box is as wide as the plane is from the middle disparity. Planes among the
disparities stay sums of points, since cells of one width would blur what is in focus. `disparity_range` finds these
disparities in milliseconds, from the gradients of one row and one column of reduced views. Where f moves by d pixels a
view step, the change from view to view is -d times the gradient g in the picture: least squares over a window give
`d = -sum g L' / sum g^2`, and g^2 weighs the windows. Gradients fail where views move by several pixels per view
step. Smaller pictures of the same lines show whether they do; then `scene_range` searches all slopes (`wide_range`).
Letters: `u v` view column and row, `x y` pixel column and row, `s` slope and `d` disparity in pixels per view step, `n`
views of a line, `h w` rows and columns of reduced pixels.
Sources: Ng et al., "Light Field Photography with a Hand-held Plenoptic Camera", 2005, section 4; Adelson, Wang, "Single
Lens Stereo with a Plenoptic Camera", 1992 (gradients).
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.geometry import Slopes
from lfref.refocus import batches, footprint
from lfref.refocus.focus.slope_range import DisparityRange, scene_range
from lfref.refocus.fourier import exact
from lfref.refocus.operator import has_traits
from lfref.refocus.shift import shift_numba, shift_plan
from lfref.refocus.shift.shift_plan import Plan, Shifts


def shift_and_sum(
    views: Tensor,
    slopes: Slopes,
    interpolation: str = "linear",
    border: str = "renormalize",
    weights: Tensor | None = None,
    fill_factor: float = 0.0,
    disparity: float | Tensor = 0.0,
    positions: Tensor | None = None,
) -> Tensor:
    """Refocus light fields at the given slopes.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        interpolation: `nearest`, `linear`, `cubic` or `exact` (Fourier shift).
        border: `renormalize` (only views with a sample there count), `edge`, `zero` or `wrap`.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.
        fill_factor: Side of the cell that each view stands for, in view steps, >= 0: 0 is the sum over points, 1 the
            integral over the aperture.
        disparity: Of the scene, in pixels per view step: at this slope cells do not blur. A number, a map [H, W], or
            one for each light field, [..., H, W].
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
    planes, cell = (
        batches.checked_slopes(slopes, grid, size, positions),
        footprint.checked(fill_factor, disparity, views),
    )
    widths = None if cell.varies else cell.widths(planes).abs().tolist()
    plan = shift_plan.plan(planes, grid, size, interpolation, border, weights, widths, positions)
    stack = planned_stack(batch, plan)
    if widths is None and cell.fill_factor > 0:
        covered = torch.stack([plan.coverage(shifts) for shifts in plan.planes])
        stack = footprint.blurred(stack, cell.widths(planes), plan.border, covered)
    return batches.restored(stack, views)


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
    plan = shift_plan.plan(planes, grid, size, interpolation, weights=weights, positions=positions)
    return torch.stack([plan.coverage(shifts) for shifts in plan.planes])


def planned_stack(views: Tensor, plan: Plan) -> Tensor:
    """The plan's stacks [B, N, C, H, W] of light fields [B, V, U, C, H, W]."""
    aperture = torch.tensor(plan.aperture)
    views = batches.without_unread(views.reshape(len(views), *aperture.shape, *views.shape[3:]), aperture)
    if plan.interpolation.weights is not None and batches.is_compiled(views):
        return shift_numba.shift_and_sum(views, plan)
    return by_torch(views, plan)


SEAM = 16
"""Samples over which a view that is not periodic is faded into its other end before a Fourier shift: at a jump the
shifted view would ring."""


def by_torch(views: Tensor, plan: Plan) -> Tensor:
    """The plan's stacks [B, N, C, H, W] by PyTorch's operations: on any device, differentiable, for `exact` too.

    A view of [B, R, M, C, H, W] is read at x + shift, by a few taps or in the Fourier domain, and added onto a sum.
    """
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


SMALLEST = 32
"""Pixels along the shorter side that reduced views keep."""
REDUCTION = 4
"""Largest factor of the reduction: disparities of some pixels must become a fraction of one."""
WINDOW = 5
"""Side of the window that shares one disparity, in reduced pixels."""
OUTLIERS = 0.04
"""Share of the gradients' energy beyond either end of the range."""
FAR = 0.75
"""Disparity in reduced pixels per view step from which the whole range is searched: gradients fail from about 1 on."""
BEYOND = 1.5
"""Disparities in reduced pixels per view step beyond which gradients are not believed, and the whole range counts."""


@torch.no_grad()
def disparity_range(views: Tensor, weights: Tensor | None = None, positions: Tensor | None = None) -> DisparityRange:
    """Estimate the disparities of one light field [V, U, C, H, W]; all 0 where nothing is known, as in flat views.

    The range is weighted by the energy of gradients: one part in 25 is below it, one above.
    """
    lines, factor = _reduced_lines(views, weights, positions)
    searched = scene_range(views, weights, positions) if _move_far(lines) else None
    if searched is not None and max(-searched.low, searched.high) > BEYOND * factor:
        return searched
    in_pixels = _range_of_lines(lines, 1, WINDOW)
    return DisparityRange(factor * in_pixels.low, factor * in_pixels.middle, factor * in_pixels.high)


@torch.no_grad()
def wide_range(views: Tensor, weights: Tensor | None = None, positions: Tensor | None = None) -> DisparityRange | None:
    """The `scene_range` of views that move by some pixels per view step; None, found faster, where they do not."""
    return scene_range(views, weights, positions) if _move_far(_reduced_lines(views, weights, positions)[0]) else None


def _reduced_lines(
    views: Tensor, weights: Tensor | None, positions: Tensor | None
) -> tuple[list[tuple[Tensor, Tensor]], int]:
    """The row and the column with the most open views: grey pictures and camera positions; and their reduction."""
    factor = max(1, min(REDUCTION, min(views.shape[-2:]) // SMALLEST))
    grid, _ = batches.grid_and_size(views)
    cameras = batches.even(grid) if positions is None else batches.checked_positions(positions, grid)
    is_open = torch.ones(grid, dtype=torch.bool) if weights is None else batches.checked_weights(weights, grid) > 0
    # Of several such rows or columns, the middlemost.
    row, column = (middlemost(counts) for counts in (is_open.sum(1), is_open.sum(0)))
    # A slice copies nothing, a mask copies the views.
    columns, rows = (slice(None) if bool(line.all()) else line for line in (is_open[row], is_open[:, column]))
    lines = [
        (F.avg_pool2d(batches.radiance(line).mean(1)[None], factor)[0], steps)
        for line, steps in ((views[row, columns], cameras[row, columns]), (views[rows, column], cameras[rows, column]))
    ]
    return lines, factor


def _move_far(lines: Sequence[tuple[Tensor, Tensor]]) -> bool:
    """Whether pictures move too far for their gradients, by what smaller pictures show."""
    factor = max(1, min(REDUCTION, min(lines[0][0].shape[1:]) // 8))
    coarse = _range_of_lines(lines, factor, WINDOW - 2)
    return max(-coarse.low, coarse.high) > FAR


def middlemost(counts: Tensor) -> int:
    """Index of the largest of these counts; of several, the middlemost."""
    best = (counts == counts.max()).nonzero()[:, 0]
    return int(best[(best - len(counts) // 2).abs().argmin()])


def _range_of_lines(lines: Sequence[tuple[Tensor, Tensor]], factor: int, window: int) -> DisparityRange:
    """Range of disparities of lines of views, pictures [n, h, w] and cameras (v, u) [n, 2]; all 0 where they are flat.

    They are reduced by a factor first; a square of `window` reduced pixels shares one disparity.
    """
    moments = sum((_moments(F.avg_pool2d(light[None], factor)[0], steps) for light, steps in lines), torch.zeros(()))
    flat = 1e-12  # energy of the gradients of flat views: rounding of float32
    if not flat <= float(moments[1].sum()) < math.inf:
        return DisparityRange(0.0, 0.0, 0.0)
    local = F.avg_pool2d(moments[None], window, 1, window // 2)[0].flatten(1)
    disparity, order = (local[0] / local[1].clamp(min=flat)).sort()
    below = local[1][order].cumsum(0) / local[1].sum()
    low, high = (
        float(disparity[min(int((below < share).sum()), len(order) - 1)]) for share in (OUTLIERS, 1 - OUTLIERS)
    )
    return DisparityRange(factor * low, factor * float(moments[0].sum() / moments[1].sum()), factor * high)


def _moments(light: Tensor, cameras: Tensor) -> Tensor:
    """-g L' and g^2 summed over the neighbours of a line of views [n, h, w] at (v, u) [n, 2]: [2, h, w]."""
    change, steps = light[1:] - light[:-1], cameras.diff(dim=0).to(light)
    between, gradient = (light[1:] + light[:-1]) / 2, torch.zeros_like(change)
    for axis in (0, 1):
        # A picture one pixel wide has no gradient, and a line of views along the other axis needs none.
        if light.shape[1 + axis] > 1 and bool(steps[:, axis].any()):
            gradient += steps[:, axis, None, None] * torch.gradient(between, dim=1 + axis)[0]
    return torch.stack([-(gradient * change).sum(0), gradient.square().sum(0)])


FADE = 0.3
"""Pixels per view step over which a sum of points gives way to one of cells: films through the planes stay smooth."""
LEAST_BLUR = 1.0
"""Least blur of a cell that counts, in pixels: copies that are nearer than one pixel do not show."""


@has_traits("compares")
def shift_and_sum_antialiased(
    views: Tensor, slopes: Slopes, weights: Tensor | None = None, positions: Tensor | None = None
) -> Tensor:
    """Refocus by shift-and-sum; where all is out of focus, each view stands for its cell of the aperture.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views, [..., N, C, H, W].
        Derivatives leave out that the range of disparities depends on the views.

    Raises:
        InputError: Views, slopes, weights or positions that cannot be used.

    Example:
        >>> views = torch.rand(7, 7, 3, 48, 64)
        >>> lfref.shift_and_sum_antialiased(views, [-2, 0, 0.5]).shape
        torch.Size([3, 3, 48, 64])
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    planes = batches.checked_slopes(slopes, grid, size, positions)
    aperture = None if weights is None else batches.checked_weights(weights, grid)
    stacks = []
    for field in batch:
        boxes = cell_widths(planes, disparity_range(field.detach(), aperture, positions)).clamp(max=min(size)).tolist()
        plan = shift_plan.plan(planes, grid, size, "cubic", weights=weights, widths=boxes, positions=positions)
        stacks.append(planned_stack(field[None], plan))
    # A single one is not copied: that would take a tenth of all the time.
    return batches.restored(torch.cat(stacks) if len(stacks) > 1 else stacks[0], views)


def cell_widths(planes: Tensor, disparities: DisparityRange) -> Tensor:
    """Width of the box that blurs each plane of these slopes, in pixels, [N]."""
    from_middle = (planes - disparities.middle).abs()
    beyond = torch.maximum(disparities.low - planes, planes - disparities.high)
    return from_middle * (beyond / FADE).clamp(0, 1) * ((from_middle - LEAST_BLUR) / FADE).clamp(0, 1)
