"""Black views, and corners that the optics leave black in every view: both get weight 0.

Corners are black because of the camera if they are round, present in all four corners of a view, and as sharp as the
camera's own edge. A dark scene has no such corners.
Each defect has a module of its own.
Letters: `V U` view rows and columns, `h w` rows and columns counted from a corner.
"""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.errors import counted
from lfref.lightfield import LightField

BLACK_VIEW = 0.05  # share of the views' median light, by trial: a view with less is black and not only vignetted
BLACK = 0.02  # share of a view's brightest twentieth, by trial: less light is a trace of compression
LEAST_CORNER = 3  # pixels along both edges, by trial: smaller corners hardly matter
LARGEST_CORNER = 0.4  # share of the sides: two corners that meet are a dark scene
RING = 1  # pixels: decoders ring at the corner's edge, and blur it by as much
TURNS = ((1, 1), (1, -1), (-1, 1), (-1, -1))  # from each corner, the direction into the picture along rows and columns


@dataclass(frozen=True, eq=False)
class BlackViewsDefect:
    """Views and corners without light."""

    name: ClassVar[str] = "black_views"
    needs_light: ClassVar[bool] = False

    views: tuple[tuple[int, int], ...]
    """Row and column of each black view."""
    corners: Tensor | None
    """Which samples lie in black corners, [V, U, 1, H, W]; None: there are none."""

    def reason_to_skip(self) -> str | None:
        """Why nothing is corrected: all views have light in all corners."""
        return None if self.views or self.corners is not None else "all views have light in all corners"

    def summary(self) -> str:
        """Number of black views, and share of black corners."""
        share = 0.0 if self.corners is None else float(self.corners.float().mean())
        texts = [counted(len(self.views), "black view")] if self.views else []
        texts += [f"black corners ({share:.1%})"] if share > 0 else []
        return f"{' and '.join(texts)} weigh nothing"

    def corrected(self, field: LightField) -> LightField:
        """The same views, weight 0 where they are black."""
        shape = (*field.grid, 1, *field.size)
        # Without corners the samples of a view share one weight in memory.
        own = (*field.grid, 1, 1, 1) if self.corners is None else shape
        weight = field.views.new_ones(own) if field.weight is None else field.weight.clone()
        if self.corners is not None:
            weight.masked_fill_(self.corners.to(weight.device), 0)
        for v, u in self.views:
            weight[v, u] = 0
        return dataclasses.replace(field, weight=weight.expand(shape))


def find(field: LightField) -> BlackViewsDefect:
    """Find black views and corners among the views that have a weight."""
    # Every fourth sample gives the brightest twentieth of a view well enough.
    brightest = field.views[..., ::4, ::4].amax(2).flatten(2)
    light = brightest.kthvalue(max(1, int(0.95 * brightest.shape[2])), 2).values
    is_used = torch.ones_like(light, dtype=torch.bool)
    if field.weight is not None:
        is_used = field.weight[..., ::4, ::4].flatten(2).amax(2) > 0
    typical = light[is_used].median() if bool(is_used.any()) else light.new_zeros(())
    is_black = is_used & (light < BLACK_VIEW * typical)
    is_used, is_black = is_used.cpu(), is_black.cpu()
    black_views = tuple((int(v), int(u)) for v, u in is_black.nonzero())
    # Black corners of the other views that have four of them.
    limit = BLACK * light[..., None, None, None]
    boxes = [_corner_region(_black_near_corner(field.views, rows, columns, limit)) for rows, columns in TURNS]
    has_all = is_used & ~is_black & torch.stack([box.flatten(2).any(2) for box in boxes]).all(0)
    if not bool(has_all.any()):
        return BlackViewsDefect(black_views, None)
    corners = torch.zeros(*field.grid, *field.size, dtype=torch.bool)
    for (rows, columns), box in zip(TURNS, boxes, strict=True):
        where = (..., _side(box.shape[2], rows), _side(box.shape[3], columns))
        corners[where] = _turned(box & has_all[..., None, None], rows, columns)
    return BlackViewsDefect(black_views, corners[:, :, None])


def _black_near_corner(views: Tensor, rows: int, columns: int, limit: Tensor) -> Tensor:
    """Black samples near one corner of all views, turned so that the corner comes first, bool, [V, U, h, w]."""
    height, width = views.shape[-2:]
    # The runs of black samples along both edges bound the box: only the box is searched, not the whole view.
    row = _widened((views[..., _side(1, rows), :] < limit).all(2))[:, :, 0]
    column = _widened((views[..., :, _side(1, columns)] < limit).all(2))[..., 0]
    h, w = (
        # 4 more samples: the ring at either end, and two samples with light that end the corner.
        max(1, min(int(_run(line if turn > 0 else line.flip(-1)).max()) + 4, int(LARGEST_CORNER * length)))
        for line, turn, length in ((column, rows, height), (row, columns, width))
    )
    box = views[..., _side(h, rows), _side(w, columns)]
    return _turned(_widened((box < limit).all(2)), rows, columns).cpu()


def _corner_region(black: Tensor) -> Tensor:
    """The black corner at the first pixel, bool, [V, U, h, w].

    Each of its rows begins at the first column and is at most as long as the row above it.
    """
    runs = _run(black).cummin(2).values
    depth = (runs > 0).sum(2)
    is_corner = (depth >= LEAST_CORNER) & (runs[..., 0] >= LEAST_CORNER)
    # A region that fills its box extends beyond the largest corner.
    is_corner &= (depth < black.shape[2]) & (runs[..., 0] < black.shape[3])
    region = (torch.arange(black.shape[3]) < runs[..., None]) & is_corner[..., None, None]
    return _widened(region)


def _widened(region: Tensor) -> Tensor:
    """A region [V, U, h, w] with the ring around it: bright samples between black ones, and dim ones beside them."""
    return F.max_pool2d(region.flatten(0, 1).float(), 2 * RING + 1, 1, RING).unflatten(0, region.shape[:2]) > 0


def _run(black: Tensor) -> Tensor:
    """Number of black samples before the first one with light, along the last axis."""
    return torch.where(black.all(-1), black.shape[-1], (~black).int().argmax(-1))


def _side(length: int, turn: int) -> slice:
    return slice(None, length) if turn > 0 else slice(-length, None)


def _turned(boxes: Tensor, rows: int, columns: int) -> Tensor:
    return boxes.flip([axis for axis, turn in ((-2, rows), (-1, columns)) if turn < 0])
