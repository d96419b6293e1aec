"""The mean disparity of a light field, and whether views move far, from the gradients of one row and one column of
reduced views: a matter of milliseconds.

Where f moves by d pixels a view step, the change from view to view is -d times the gradient g in the picture: least
squares over a window give `d = -sum g L' / sum g^2`, and g^2 weighs the windows. Gradients fail where views move by
several pixels per view step. Smaller pictures of the same lines show whether they do (`wide_range`, for which the host
waits); then `scene_range` searches all slopes.
Letters: `v u` camera position, `d` disparity in pixels per view step, `n` views of a line, `h w` rows and columns of
reduced pixels.
Source: Adelson, Wang, "Single Lens Stereo with a Plenoptic Camera", 1992.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.functional import neighbours
from lfref.functional.devices import number, on_device, on_host
from lfref.refocus import batches
from lfref.refocus.focus.slope_range import DisparityRange, scene_range

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
SPREAD = 1.1
"""Range of disparities in reduced pixels per view step from which it is searched too: light at its ends is confused."""
BEYOND = 1.5
"""Disparities in reduced pixels per view step beyond which gradients are not believed, and the whole range counts."""


class Ends(NamedTuple):
    """The disparities of a scene in pixels per view step, float64, on the device of the views, []."""

    low: Tensor
    """Lower end."""
    middle: Tensor
    """Mean."""
    high: Tensor
    """Upper end."""


class LineViews(NamedTuple):
    """The row and the column with the most open views."""

    lines: tuple[tuple[Tensor, list[list[float]]], ...]
    """Reduced grey pictures [n, h, w] of both, and the steps (v, u) from one camera to the next, [n - 1, 2]."""
    factor: int
    """Pixels along each side of a reduced pixel."""


@torch.no_grad()
def wide_range(views: Tensor, weights: Tensor | None = None, positions: Tensor | None = None) -> DisparityRange | None:
    """The `scene_range` of views that move by some pixels per view step; None, found faster, where they do not."""
    is_wide = bool(move_far(line_views(views, weights, positions)))
    return scene_range(views, weights, positions) if is_wide else None


@torch.no_grad()
def middle_of(lines: LineViews, known: DisparityRange | None) -> Tensor:
    """Mean disparity of lines by the energy of gradients; that of `known`, the range of wide views, where they fail."""
    farthest = BEYOND * lines.factor
    if known is not None and max(-known.low, known.high) > farthest:
        return number(known.middle, lines.lines[0][0])
    return _range_of_lines(lines, 1, WINDOW).middle.clamp(-farthest, farthest)


@torch.no_grad()
def move_far(lines: LineViews) -> Tensor:
    """Whether pictures move too far for their gradients, by what smaller pictures show, or differently far: a bool."""
    factor = max(1, min(REDUCTION, min(lines.lines[0][0].shape[1:]) // 8))
    coarse, fine = _range_of_lines(lines, factor, WINDOW - 2), _range_of_lines(lines, 1, WINDOW)
    is_far = torch.maximum(-coarse.low, coarse.high) > FAR * lines.factor
    return is_far | (fine.high - fine.low > SPREAD * lines.factor)


@torch.no_grad()
def line_views(views: Tensor, weights: Tensor | None = None, positions: Tensor | None = None) -> LineViews:
    """The lines of a light field [V, U, C, H, W]."""
    # Length by length: a file of views that are large enough need not compare them.
    factor = min(max(1, min(REDUCTION, length // SMALLEST)) for length in views.shape[-2:])
    grid, _ = batches.grid_and_size(views)
    return LineViews(
        tuple(
            (
                F.avg_pool2d(torch.stack([batches.radiance(views[index]).mean(0) for index in line])[None], factor)[0],
                steps,
            )
            for line, steps in _longest_lines(grid, weights, positions)
        ),
        factor,
    )


@on_host
def _longest_lines(
    grid: tuple[int, int], weights: Tensor | None, positions: Tensor | None
) -> list[tuple[list[tuple[int, int]], list[list[float]]]]:
    """Indices of the open views of a row and of a column, and the steps (v, u) between them."""
    cameras = batches.even(grid) if positions is None else batches.checked_positions(positions, grid)
    is_open = batches.checked_weights(weights, grid) > 0
    # Of several rows or columns with as many open views, the middlemost.
    row, column = (middlemost(counts) for counts in (is_open.sum(1), is_open.sum(0)))
    lines = (
        [(row, u) for u in is_open[row].nonzero()[:, 0].tolist()],
        [(v, column) for v in is_open[:, column].nonzero()[:, 0].tolist()],
    )
    return [(line, torch.stack([cameras[index] for index in line]).diff(dim=0).tolist()) for line in lines]


@on_host
def cross(
    grid: tuple[int, int], weights: Tensor | None, positions: Tensor | None
) -> tuple[list[tuple[int, int]], Tensor, Tensor]:
    """Open views of a row and a column in the order of the grid: indices, positions (v, u) [M, 2], even weights [M]."""
    cameras = batches.even(grid) if positions is None else batches.checked_positions(positions, grid)
    places = sorted({place for line, _ in _longest_lines(grid, weights, positions) for place in line})
    even = torch.full((len(places),), 1 / len(places), dtype=torch.float64)
    return places, torch.stack([cameras[place] for place in places]), even


def middlemost(counts: Tensor) -> int:
    """Index of the largest of these counts; of several, the middlemost."""
    best = (counts == counts.max()).nonzero()[:, 0]
    return int(best[(best - len(counts) // 2).abs().argmin()])


def _range_of_lines(lines: LineViews, factor: int, window: int) -> Ends:
    """Range of disparities of lines in pixels of the views; all 0 where they are flat.

    They are reduced by a factor first; a square of `window` reduced pixels shares one disparity.
    """
    first, second = (_moments(F.avg_pool2d(light[None], factor)[0], steps) for light, steps in lines.lines)
    moments = first + second
    flat = 1e-12  # energy of the gradients of flat views: rounding of float32
    local = F.avg_pool2d(moments[None], window, 1, window // 2)[0].flatten(1)
    disparity, order = (local[0] / local[1].clamp(min=flat)).sort()
    energy = moments[1].sum()
    below = local[1].index_select(0, order).cumsum(0) / local[1].sum()
    ends = [
        disparity.gather(0, (below < share).sum().clamp(max=order.shape[0] - 1)[None])[0]
        for share in (OUTLIERS, 1 - OUTLIERS)
    ]
    is_known = (energy >= flat) & (energy < math.inf)
    low, middle, high = (
        torch.where(is_known, factor * lines.factor * value, 0.0).double()
        for value in (ends[0], moments[0].sum() / energy, ends[1])
    )
    return Ends(low, middle, high)


def _moments(light: Tensor, steps: list[list[float]]) -> Tensor:
    """-g L' and g^2 summed over the neighbours of a line of views [n, h, w], [2, h, w], at steps (v, u) [n - 1, 2]."""
    change = light[1:] - light[:-1]
    between, gradient = (light[1:] + light[:-1]) / 2, torch.zeros_like(change)
    for axis, along in enumerate(zip(*steps, strict=True)):
        # A picture one pixel wide has no gradient, and a line of views along the other axis needs none.
        if light.shape[1 + axis] > 1 and any(along):
            step = on_device(torch.tensor(along), light.device, light.dtype)[:, None, None]
            gradient = gradient + step * neighbours.gradient(between, 1 + axis)
    return torch.stack([-(gradient * change).sum(0), gradient.square().sum(0)])
