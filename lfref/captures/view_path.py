"""The path of a camera whose pictures were read as one row: a grid, a serpentine, there and back, or no path at all.

Between neighbours of a row every part of the picture moves on in the same direction. Where the camera turns, at the end
of a grid's row, it does not; on a serpentine path it moves back from there. Pictures of a focal stack differ without
moving. The motion from one small picture to the next is found in windows by least squares, from gradients.
Letters: `N` pictures, `W` windows, `y x` pixel row and column.
"""

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.functional import neighbours
from lfref.lightfield import LightField

FEWEST = 6
"""Fewest pictures whose path is judged."""
SIDE, WINDOWS = 64, 4
"""Shorter side of the small pictures, in pixels, at least, and windows along each side."""
TURNED = 0.7
"""Least difference of a step from the first steps where the camera turns, as a share of the first steps."""
EXPLAINED = 0.05
"""Least share of the differences of neighbours that motion explains: views have .2 and more, a focal stack .004."""


@torch.no_grad()
def advice(field: LightField) -> str | None:
    """What is wrong with the order of views, and what to do, in one line; else None."""
    n_views, is_line = math.prod(field.grid), min(field.grid) == 1
    if n_views < FEWEST or min(field.size) < 2 or field.positions is not None or field.weight is not None:
        return None
    motion, explained = _motion(field.views.flatten(0, 1).mean(1))
    if is_line and explained < EXPLAINED:
        return "the views differ, but nothing moves between them: a focal stack is no light field"
    along = _steps(motion)
    turns = ((along - 1).abs() > TURNED).nonzero()[:, 0].tolist()
    if not turns:
        return None
    n_columns = turns[0] + 1
    n_rows, rest = divmod(n_views, n_columns)
    back = along[n_columns - 1 :]
    if is_line and bool((back < TURNED - 1).all()) and n_columns > 2:
        return f"the camera goes back after {n_columns} views: set reader.angular_size=[1,{n_columns}] reader.start=0"
    if rest or n_columns < 2 or turns != _turns_of(along, n_rows, n_columns):
        return None
    is_serpentine = bool((along[n_columns : 2 * n_columns - 1] < 0).all())
    if not is_line and not is_serpentine:
        return None
    # Whole rows that move the picture up and down are columns.
    down, across = motion[: n_columns - 1].square().sum((0, 1))
    is_transposed = bool(down > across)
    shape = (n_columns, n_rows) if is_transposed else (n_rows, n_columns)
    words = [f"reader.grid=[{shape[0]},{shape[1]}]"]
    words += ["reader.pattern=serpentine"] * is_serpentine + ["reader.transpose=true"] * is_transposed
    return f"the views seem to be {shape[0]} rows of {shape[1]}: set {' '.join(words)}"


def _turns_of(along: Tensor, n_rows: int, n_columns: int) -> list[int]:
    """Steps that are no step of the first row if the views are a grid, by the direction of its second row."""
    ends = {row * n_columns - 1 for row in range(1, n_rows)}
    is_back = float(along[n_columns]) < 0
    back = {row * n_columns + step for row in range(1, n_rows, 2) for step in range(n_columns - 1) if is_back}
    return sorted(ends | back)


def _steps(motion: Tensor) -> Tensor:
    """Component of each motion [N - 1, W, 2] along the mean of the first two, as a multiple of that mean, [N - 1]."""
    first = motion[:2].mean(0)
    return (motion * first).sum((1, 2)) / first.square().sum().clamp(min=torch.finfo(motion.dtype).tiny)


def _motion(pictures: Tensor) -> tuple[Tensor, float]:
    """Motion (y, x) of each window between neighbours of grey pictures [N, H, W], and the share of their differences
    that it explains, 1 if they are alike."""
    factor = max(1, min(pictures.shape[1:]) // SIDE)
    small = F.avg_pool2d(pictures[:, None], factor)[:, 0].double()
    small = small - small.mean((1, 2), keepdim=True)
    change, between = small[1:] - small[:-1], (small[1:] + small[:-1]) / 2
    down, across = (neighbours.gradient(between, axis) for axis in (-2, -1))

    def summed(values: Tensor) -> Tensor:
        return F.adaptive_avg_pool2d(values[:, None], WINDOWS).flatten(1)

    moments = torch.stack([summed(down * down), summed(down * across), summed(across * across)])
    right = -torch.stack([summed(down * change), summed(across * change)], -1)
    yy, yx, xx = moments + torch.tensor([1.0, 0.0, 1.0])[:, None, None] * 1e-3 * (moments[0] + moments[2]).mean()
    inverse = (
        torch.stack([torch.stack([xx, -yx], -1), torch.stack([-yx, yy], -1)], -2) / (yy * xx - yx**2)[..., None, None]
    )
    motion = (inverse @ right[..., None])[..., 0]
    # In windows of strong gradients the motion is sure.
    weight = (moments[0] + moments[2]).sqrt()
    left = float(summed(change.square()).sum())
    return motion * weight[..., None], float((motion * right).sum()) / left if left > 0 else 1.0
