"""Order of the views: files that count views down the columns, or along one axis in the other direction; and pictures
of a moving camera, read as one row, which are a grid, a serpentine, there and back, or no path at all.

The order is the one whose steps explain the motion between a few small views. A plane sweep leaves some variance
unexplained at each pixel; a pixel votes for an order that leaves at most a quarter of the variance of the other order.
Reversing both axes only exchanges near and far, so that four of the eight orders make different pictures.
1. Transposition, for the column and for the row of views through the centre: they move the picture along y and x, or,
   transposed, along x and y. Both must vote for it: stripes seem to move across themselves, whatever moves them.
2. Reversal: the views of both lines must agree about one disparity.
Between neighbours of a row every part of the picture moves on in the same direction. Where the camera turns, at the end
of a grid's row, it does not; on a serpentine path it moves back from there. Pictures of a focal stack differ without
moving. The motion from one small picture to the next is found in windows by least squares, from gradients.
Letters: `v u` view row and column, `y x` pixel row and column, `N` pictures, `W` windows.
"""

import dataclasses
import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.captures import Defect
from lfref.functional import neighbours
from lfref.lightfield import LightField
from lfref.refocus.focus import slope_range
from lfref.refocus.focus.slope_range import FLOOR, ReducedViews, SlopeFit

CLEARLY = 4.0  # times the variance that another order must leave at a pixel before the pixel votes, by trial
# Share of the picture that must vote for another order. Of 40 scenes and captures, read in another order, all but the
# two with stripes in one direction have at least 4 %; in the right order, at most a pixel in a thousand votes.
VOTES = 0.03
MAJORITY = 10.0  # votes for an order to each vote against it, by trial
IN_ORDER = "no other order explains the views better"
FEWEST = 6  # fewest pictures whose path is judged
SIDE, WINDOWS = 64, 4  # shorter side of the small pictures, in pixels, at least; windows along each side
TURNED = 0.7  # least difference of a step from the first steps where the camera turns, as a share of these
EXPLAINED = 0.05  # least share of neighbours' differences explained by motion: views have .2, a focal stack .004


@dataclass(frozen=True, eq=False)
class ViewOrderDefect(Defect):
    """Views in another order than rows from the top, each from the left."""

    name = "view_order"

    is_transposed: bool  # whether the views are counted down the columns
    is_reversed: bool
    """Whether one axis is reversed (which of them cannot be known), after the transposition if there is one."""

    @property
    def remedy(self) -> str:
        """Options of the reader that give our order, such as `reader.transpose=true`."""
        options = ["reader.transpose=true"] * self.is_transposed + ["reader.reverse_v=true"] * self.is_reversed
        return " ".join(options)

    def summary(self) -> str:
        """What is wrong, and the options of the reader that give our order."""
        parts = ["views seem counted down the columns"] * self.is_transposed
        parts += ["one axis of the views seems reversed"] * self.is_reversed
        return f"{' and '.join(parts)} ({self.remedy})"

    def corrected(self, field: LightField) -> LightField:
        """The same views in our order."""

        def ordered(stored: Tensor) -> Tensor:
            stored = stored.transpose(0, 1) if self.is_transposed else stored
            return (stored.flip(0) if self.is_reversed else stored).contiguous()

        weight, positions = (None if each is None else ordered(each) for each in (field.weight, field.positions))
        if positions is not None:
            v, u = (positions.flip(-1) if self.is_transposed else positions).unbind(-1)
            positions = torch.stack([-v if self.is_reversed else v, u], -1)
        return dataclasses.replace(field, views=ordered(field.views), weight=weight, positions=positions)


@torch.no_grad()
def find(reduced: ReducedViews) -> ViewOrderDefect | str:
    """The order that explains reduced views of a light field."""
    reduced = slope_range.smallest(reduced)
    lines = reduced.along(0), reduced.along(1)
    # A single line of views cannot be certain.
    if min(len(views.indices) for views in lines) < 2 or min(reduced.pictures.shape[1:]) < 2:
        return IN_ORDER
    is_transposed = all(_is_clear(_fit(views, views.steps), _fit(views, views.steps.flip(1))) for views in lines)
    steps = reduced.steps.flip(1) if is_transposed else reduced.steps
    forth, back = (_fit(reduced, steps * torch.tensor([row, 1.0]).to(steps)) for row in (1.0, -1.0))
    is_reversed = _is_clear(forth, back)
    return ViewOrderDefect(is_transposed, is_reversed) if is_transposed or is_reversed else IN_ORDER


def _fit(reduced: ReducedViews, steps: Tensor) -> SlopeFit:
    """The best fit among all slopes, where views stand at these steps."""
    return slope_range.widest_fit(dataclasses.replace(reduced, steps=steps))


def _is_clear(plain: SlopeFit, other: SlopeFit) -> bool:
    """Whether another order explains enough of the picture clearly better than the plain one, and hardly any worse."""
    gain = ((plain.unexplained + FLOOR) / (other.unexplained + FLOOR)).log()
    votes, against = ((sign * gain > math.log(CLEARLY)).float().mean() for sign in (1, -1))
    return bool(votes > VOTES and votes > MAJORITY * against)


@torch.no_grad()
def path_advice(field: LightField) -> str | None:
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
