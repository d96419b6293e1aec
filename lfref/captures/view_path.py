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
    # Component of each motion along the mean of the first two, as a multiple of that mean.
    first = motion[:2].mean(0)
    along = (motion * first).sum((1, 2)) / first.square().sum().clamp(min=torch.finfo(motion.dtype).tiny)
    is_turn = (along - 1).abs() > TURNED
    n_columns = int(is_turn.int().argmax()) + 1
    back = along[n_columns - 1 :]
    if is_line and bool((back < TURNED - 1).all()) and n_columns > 2:
        return f"the camera goes back after {n_columns} views: set reader.angular_size=[1,{n_columns}] reader.start=0"
    n_rows, rest = divmod(n_views, n_columns)
    is_serpentine = bool((along[n_columns : 2 * n_columns - 1] < 0).all())
    # The step behind a row is a turn, and so are all steps of every second row of a serpentine.
    expected = torch.zeros(n_rows, n_columns, dtype=torch.bool)
    expected[1::2] = is_serpentine
    expected[:, -1] = True
    is_path = not rest and torch.equal(is_turn.cpu(), expected.flatten()[:-1])
    if n_columns < 2 or not is_path or not (is_line or is_serpentine):
        return None
    # Whole rows that move the picture up and down are columns.
    down, across = motion[: n_columns - 1].square().sum((0, 1))
    is_transposed = bool(down > across)
    shape = (n_columns, n_rows) if is_transposed else (n_rows, n_columns)
    words = [f"reader.grid=[{shape[0]},{shape[1]}]"]
    words += ["reader.pattern=serpentine"] * is_serpentine + ["reader.transpose=true"] * is_transposed
    return f"the views seem to be {shape[0]} rows of {shape[1]}: set {' '.join(words)}"


def _motion(pictures: Tensor) -> tuple[Tensor, float]:
    """Motion (y, x) of each window between neighbours of grey pictures [N, H, W], and the share of their differences
    that it explains, 1 if they are alike."""
    factor = max(1, min(pictures.shape[1:]) // SIDE)
    small = F.avg_pool2d(pictures[:, None], factor)[:, 0].double()
    small = small - small.mean((1, 2), keepdim=True)
    change, between = small[1:] - small[:-1], (small[1:] + small[:-1]) / 2
    values = torch.stack([*(neighbours.gradient(between, axis) for axis in (-2, -1)), -change], 1)
    # Means of products of (gradient down, gradient to the right, minus the change) in each window.
    products = (values[:, :, None] * values[:, None]).flatten(1, 2)
    means = F.adaptive_avg_pool2d(products, WINDOWS).flatten(2).mT.unflatten(2, (3, 3))
    squares, right = means[..., :2, :2], means[..., :2, 2]
    trace = squares.diagonal(dim1=-2, dim2=-1).sum(-1)
    ridge = 1e-3 * trace.mean() + torch.finfo(trace.dtype).tiny
    motion = torch.linalg.solve(squares + ridge * torch.eye(2).to(squares), right)
    left = float(means[..., 2, 2].sum())
    # In windows of strong gradients the motion is sure.
    return motion * trace.sqrt()[..., None], float((motion * right).sum()) / left if left > 0 else 1.0
