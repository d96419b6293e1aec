"""Order of the views: files that count views down the columns, or along one axis in the other direction.

The order is the one whose steps explain the motion between a few small views. A plane sweep leaves some variance
unexplained at each pixel; a pixel votes for an order that leaves at most a quarter of the variance of the other order.
Reversing both axes only exchanges near and far, so that four of the eight orders make different pictures.
1. Transposition, for the column and for the row of views through the centre: they move the picture along y and x, or,
   transposed, along x and y. Both must vote for it: stripes seem to move across themselves, whatever moves them.
2. Reversal: the views of both lines must agree about one disparity.
Letters: `v u` view row and column, `y x` pixel row and column.
"""

import dataclasses
import math
from dataclasses import dataclass

import torch
from torch import Tensor

from lfref.captures import Defect
from lfref.lightfield import LightField
from lfref.refocus.focus import slope_range
from lfref.refocus.focus.slope_range import FLOOR, ReducedViews, SlopeFit

CLEARLY = 4.0  # times the variance that another order must leave at a pixel before the pixel votes, by trial
# Share of the picture that must vote for another order. Of 40 scenes and captures, read in another order, all but the
# two with stripes in one direction have at least 4 %; in the right order, at most a pixel in a thousand votes.
VOTES = 0.03
MAJORITY = 10.0  # votes for an order to each vote against it, by trial
IN_ORDER = "no other order explains the views better"


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
