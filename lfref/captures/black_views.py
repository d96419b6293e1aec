"""Black views: views without light, and corners that the optics leave black in every view; both weigh nothing.

Corners count as black where a camera makes them so: round ones, in all four corners of a view, and as sharp as the
camera's own edge. A dark scene has no such corners.
Letters: `V U` view rows and columns; `y x` rows and columns counted from a corner.
"""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.captures.defect import Correction, Evidence
from lfref.lightfield import LightField

NO_LIGHT = 0.05  # of the light of most views: a view below is black
BLACK = 0.02  # of the brightest twentieth of a view: samples below hold no light, but what compression leaves
LEAST_CORNER = 3  # pixels along both edges that are black in a black corner
REACH = 0.4  # of the sides that a corner may take
RING = 1  # pixels between black ones that decoders leave bright, as ringing of the corner's edge does
FADE = 1  # pixels beside those, that are dim
MARGIN = RING + FADE + 2
TURNS = ((1, 1), (1, -1), (-1, 1), (-1, -1))  # from each corner, the ways into the picture along rows and columns


@dataclass(frozen=True, eq=False)
class BlackViews:
    """Views and corners without light."""

    name: ClassVar[str] = "black_views"

    views: tuple[tuple[int, int], ...]
    """Row and column of each view that is black."""
    corners: Tensor | None
    """Which samples are in the black corners of a view, [V, U, 1, H, W]; None: there are none."""

    def inert(self) -> str | None:
        """Nothing changes where all views have light, and their corners too."""
        return None if self.views or self.corners is not None else "all views have light in all corners"

    def told(self) -> str:
        """How many views, and how much of the others."""
        share = 0.0 if self.corners is None else float(self.corners.float().mean())
        texts = [f"{len(self.views)} black views"] * bool(self.views) + [f"black corners ({share:.1%})"] * (share > 0)
        return f"{' and '.join(texts)} weigh nothing"

    def corrected(self, field: LightField) -> LightField:
        """The same views, what is black in them without weight."""
        n_rows, n_columns, _, height, width = field.views.shape
        weight = field.views.new_ones(n_rows, n_columns, 1, height, width) if field.weight is None else field.weight
        weight = weight.clone()
        if self.corners is not None:
            weight.masked_fill_(self.corners.to(weight.device), 0)
        for v, u in self.views:
            weight[v, u] = 0
        return dataclasses.replace(field, weight=weight)


def find(evidence: Evidence) -> BlackViews:
    """Find what is black, views that have no weight anyway excepted.

    Args:
        evidence: Of the light field.
    """
    field = evidence.field
    tops = field.views[..., ::4, ::4].amax(2).flatten(2)
    light = tops.kthvalue(max(1, int(0.95 * tops.shape[2])), 2).values
    is_used = torch.ones_like(light, dtype=torch.bool)
    if field.weight is not None:
        is_used = field.weight[..., ::4, ::4].flatten(2).amax(2) > 0
    typical = light[is_used].median() if bool(is_used.any()) else light.new_zeros(())
    is_black = is_used & (light < NO_LIGHT * typical)
    return BlackViews(
        tuple((int(v), int(u)) for v, u in is_black.nonzero()), _corners(field.views, light, is_used & ~is_black)
    )


def _corners(views: Tensor, light: Tensor, is_used: Tensor) -> Tensor | None:
    """Samples of black corners, of used views with four of them, bool, [V, U, 1, H, W]."""
    limit = BLACK * light[..., None, None, None]
    boxes = [_region(_corner(views, rows, columns, limit)) for rows, columns in TURNS]
    has_all = is_used & torch.stack([box.flatten(2).any(2) for box in boxes]).all(0)
    if not bool(has_all.any()):
        return None
    found = torch.zeros(*views.shape[:2], *views.shape[-2:], dtype=torch.bool)
    for (rows, columns), box in zip(TURNS, boxes, strict=True):
        place = (..., _side(box.shape[2], rows), _side(box.shape[3], columns))
        found[place] = _turned(box & has_all[..., None, None].cpu(), rows, columns)
    return found[:, :, None]


def _corner(views: Tensor, rows: int, columns: int, limit: Tensor) -> Tensor:
    """What is black about one corner of all views, as if that were the first pixel, bool, [V, U, h, w]."""
    height, width = views.shape[-2:]
    edges = views[..., _side(1, rows), :], views[..., :, _side(1, columns)]
    lines = _closed((edges[0] < limit).all(2))[:, :, 0], _closed((edges[1] < limit).all(2))[..., 0]
    longest = (
        min(int(_run(line if turn > 0 else line.flip(-1)).max()) + MARGIN, int(REACH * length))
        for line, turn, length in zip(reversed(lines), (rows, columns), (height, width), strict=True)
    )
    h, w = (max(1, length) for length in longest)
    box = views[..., _side(h, rows), _side(w, columns)]
    return _turned(_closed((box < limit).all(2)), rows, columns).cpu()


def _region(black: Tensor) -> Tensor:
    """The black corner about the first pixel: it narrows away from both edges, [V, U, h, w] of the same."""
    runs = _run(black).cummin(2).values
    depth = (runs > 0).sum(2)
    is_corner = (depth >= LEAST_CORNER) & (runs[..., 0] >= LEAST_CORNER)
    # One that fills its box goes on beyond what a corner may take.
    is_corner &= (depth < black.shape[2]) & (runs[..., 0] < black.shape[3])
    region = (torch.arange(black.shape[3]) < runs[..., None]) & is_corner[..., None, None]
    return _wider(region, FADE)


def _closed(black: Tensor) -> Tensor:
    """Black with what lies between black samples, and beside them, bool, [V, U, h, w]."""
    return _wider(black, RING)


def _wider(region: Tensor, by: int) -> Tensor:
    return F.max_pool2d(region.flatten(0, 1).float(), 2 * by + 1, 1, by).unflatten(0, region.shape[:2]) > 0


def _run(black: Tensor) -> Tensor:
    """How many of the first samples along the last axis are black."""
    return torch.where(black.all(-1), black.shape[-1], (~black).int().argmax(-1))


def _side(length: int, turn: int) -> slice:
    return slice(None, length) if turn > 0 else slice(-length, None)


def _turned(boxes: Tensor, rows: int, columns: int) -> Tensor:
    return boxes.flip([axis for axis, turn in ((-2, rows), (-1, columns)) if turn < 0])


BLACK_VIEWS = Correction(BlackViews, "views that are lit, to compare with", find)
