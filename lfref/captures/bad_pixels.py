"""Samples without light of the scene: hot and dead pixels, black views, and corners that the optics leave black.

Hot and dead pixels stick out of their surroundings, in one view and one colour alone. A photosite records one colour: a
glint, a star or a firefly of a path tracer, whose spot looks alike in several colours, is none. Nor is a spot that
neighbouring views show too, at the place of any disparity of the scene. They are replaced by the mean of the samples
beside them, channel by channel: weights of 0 would slow down all refocusing for a handful of samples. Samples that a
mosaic has spoilt beside them are replaced too.
Black views and corners get weight 0. Corners are black because of the camera if they are round, present in all four
corners of a view, and as sharp as the camera's own edge. A dark scene has no such corners.
Letters: `V U` view rows and columns, `C` channels, `K` samples, `v u c y x` their indices; `h w` rows and columns
counted from a corner.
"""

import dataclasses
import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.captures import Defect, registration
from lfref.errors import counted
from lfref.lightfield import LightField

# The height of a sample is its distance above the largest, or below the smallest, of the eight around it.
FAR = 12.0  # times the mean height of all local extremes: one in e^12 extremes of noise is higher
LEAST = 0.02  # share of the brightest samples, by trial: smaller heights hardly show
MOST = 1 << 13  # candidates of a channel, by trial: more are texture
UNCONFIRMED = 0.5  # share of the height, by trial: the neighbouring views must lack at least this
ABOVE_DETAIL = 1.3  # times the range of the surroundings, by trial: smaller heights may be detail
ABOVE_ERROR = 1.5  # times the disagreement of neighbouring views, by trial, if most candidates are above that
FEW = 3  # samples, by trial: so few may be chance
RARE = 0.01  # share of the candidates, by trial: so few may be detail, whatever they look like
SPOILT = 0.15  # share of the height from which samples beside a hot one count as spoilt by it, by trial
SHARED = 0.15  # share of the height, by trial: another colour that sticks out by less records another spot
ALIKE = 0.08  # share of the height: half of the least by which Malvar's kernels spread a hot colour farther than others
ROUGH = 0.3  # standard deviations of the surroundings, by trial, by which a spread may err
CLIPPED = 0.98  # share of the brightest sample, by trial: compression changes clipped samples a little
BESIDE = 1  # pixels per view step that disparities may lie beyond those of the map, by trial
REACH = 3  # pixels around a sample: a mosaic spoils 2, and the ring around them shows the detail
WIDTH = 0.6  # pixels, by trial: standard deviation of the weights of the samples that replace a hot one
BLACK_VIEW = 0.05  # share of the views' median light, by trial: a view with less is black and not only vignetted
BLACK = 0.02  # share of a view's brightest twentieth, by trial: less light is a trace of compression
LEAST_CORNER = 3  # pixels along both edges, by trial: smaller corners hardly matter
LARGEST_CORNER = 0.4  # share of the sides: two corners that meet are a dark scene
RIM = 1  # pixels: decoders ring at the corner's edge, and blur it by as much
CONFIRMED = "other views confirm every sample that sticks out"


@dataclass(frozen=True, eq=False)
class HotPixelsDefect(Defect):
    """Samples that are hot or dead."""

    name = "hot_pixels"

    samples: Tensor  # view row and column, channel, pixel row and column of each sample, [K, 5]
    count: int  # number of hot and dead samples, without those that they have spoilt

    def summary(self) -> str:
        """Number of hot and dead samples."""
        samples = counted(self.count, "hot or dead sample takes", "hot or dead samples take")
        return f"{samples} the mean of the samples beside them"

    def corrected(self, field: LightField) -> LightField:
        """The light field with these samples replaced."""
        is_hot = torch.zeros(field.views.shape, dtype=torch.bool)
        is_hot[self.samples.unbind(1)] = True
        offsets = torch.arange(-REACH, REACH + 1).square().double()
        nearness = (-(offsets[:, None] + offsets) / (2 * WIDTH**2)).exp()
        surroundings = _patches(field.views, self.samples)
        weight = (nearness * ~_patches(is_hot, self.samples)).to(surroundings)
        views = field.views.clone()
        # The minimum 1e-12 is for a sample with only hot samples around.
        mean = (weight * surroundings).sum((1, 2)) / weight.sum((1, 2)).clamp(min=1e-12)
        views[self.samples.unbind(1)] = mean
        return dataclasses.replace(field, views=views)


def find_hot(field: LightField, disparity: Tensor, reference: tuple[int, int]) -> HotPixelsDefect | str:
    """Find hot and dead pixels; the disparity [H, W] is that of the reference view."""
    if field.grid[0] * field.grid[1] < 3:
        return CONFIRMED
    samples, heights = candidates(field.views)
    if not len(samples):
        return CONFIRMED
    positions = registration.positions_of(field).unflatten(0, field.grid).movedim(-1, 0).float()
    steps, disparity = positions - positions[:, reference[0], reference[1], None, None], disparity.cpu()
    # The disparity at a sample's own place leads to the place in the reference view, and to the disparity there.
    v, u, _, y, x = samples.unbind(1)
    moves = zip((y, x), disparity[y, x] * steps[:, v, u], disparity.shape, strict=True)
    row, column = ((place - move).round().long().clamp(0, length - 1) for place, move, length in moves)
    own = _patches(field.views, samples).float()
    others = _in_neighbours(field.views, samples, disparity[row, column], steps)
    # The median over the neighbouring views: one of them may have a hot sample at the same place.
    others = others.nanquantile(0.5, 0)
    is_new = is_unconfirmed(own, others, heights)
    colours = [_patches(field.views, samples.index_fill(1, torch.tensor(2), c)) for c in range(field.views.shape[2])]
    is_single = is_of_one_colour(torch.stack(colours).float())
    is_hot = is_new & is_single
    # A scene with more spots in all colours has glints: those in one colour may be glints of coloured light.
    if int(is_hot.sum()) <= int((is_new & ~is_single).sum()):
        return CONFIRMED
    suspects = is_hot.nonzero()[:, 0]
    low, high = float(disparity.min()) - BESIDE, float(disparity.max()) + BESIDE
    # A spot that two neighbours show at one disparity is a point of the scene; places are compared within a pixel.
    for d in torch.arange(low, high + 1.5, 1.5).tolist():
        places = _in_neighbours(field.views, samples[suspects], torch.full((len(suspects),), d), steps)
        is_hot[suspects] &= (sticking_as_far(places, own[suspects], heights[suspects])).sum(0) < 2
    if not bool(is_hot.any()):
        return CONFIRMED
    spoilt = with_spoilt(own[is_hot], others[is_hot], samples[is_hot], field.size)
    return HotPixelsDefect(spoilt, int(is_hot.sum()))


def candidates(views: Tensor) -> tuple[Tensor, Tensor]:
    """Samples that stick out of their view, [K, 5], and their heights, [K]; channels with too many are left out."""
    samples, found = [torch.zeros(0, 5, dtype=torch.long)], [torch.zeros(0)]
    for channel in range(views.shape[2]):
        images = views[:, :, channel].detach().float().cpu()
        # One image at a time stays in the processor's cache.
        heights = torch.stack([heights_of(image) for image in images.flatten(0, 1)]).unflatten(0, images.shape[:2])
        # Every eighth row is enough for the mean height and the brightest samples.
        extremes, brightest = heights[..., ::8, :], float(np.quantile(images[..., ::8, ::8], 0.99))
        limit = max(FAR * float(extremes[extremes > 0].double().mean().nan_to_num()), LEAST * brightest)
        v, u, y, x = (heights > limit).nonzero().unbind(1)
        if len(v) < MOST and np.isfinite(limit):
            samples.append(torch.stack([v, u, torch.full_like(v, channel), y + 1, x + 1], 1))
            found.append(heights[v, u, y, x])
    return torch.cat(samples), torch.cat(found)


def _patches(views: Tensor, samples: Tensor) -> Tensor:
    """Surroundings of samples, edges repeated, on the CPU, [K, 2 REACH + 1, 2 REACH + 1]."""
    v, u, c, y, x = samples.unbind(1)
    around = torch.arange(-REACH, REACH + 1)
    rows = (y[:, None] + around).clamp(0, views.shape[-2] - 1)
    columns = (x[:, None] + around).clamp(0, views.shape[-1] - 1)
    v, u, c = (index[:, None, None] for index in (v, u, c))
    return views[v, u, c, rows[:, :, None], columns[:, None, :]].cpu()


def _in_neighbours(views: Tensor, samples: Tensor, disparity: Tensor, steps: Tensor) -> Tensor:
    """Surroundings of samples of some disparity [K] in the views around each view (or opposite), [N, K, 7, 7]."""
    v, u, c = samples[:, :3].unbind(1)
    last = torch.tensor(views.shape)[[0, 1, 3, 4]] - 1
    moves = [move for move in itertools.product(*((-1, 0, 1) if n else (0,) for n in last[:2])) if any(move)]
    cells = samples[:, :2] + torch.tensor(moves)[:, None]
    # Beyond the grid, the view on the opposite side.
    to_v, to_u = (last[:2] - (last[:2] - cells.abs()).abs()).unbind(-1)
    shifts = (disparity * (steps[:, to_v, to_u] - steps[:, v, u][:, None])).movedim(0, -1)
    to_y, to_x = torch.minimum((samples[:, 3:] + shifts).round().long().clamp(min=0), last[2:]).unbind(-1)
    places = torch.stack([to_v, to_u, c.expand_as(to_v), to_y, to_x], -1)
    return _patches(views, places.flatten(0, 1)).unflatten(0, places.shape[:2]).float()


def is_of_one_colour(colours: Tensor) -> Tensor:
    """Whether spots amid all channels, [C, K, 7, 7], show in one alone, or spread farther there by a mosaic, [K]."""
    ring = _ring()
    spots = colours - colours[..., ring].median(-1).values[..., None, None]
    top = spots[..., REACH, REACH]
    highest = top.abs().argmax(0, keepdim=True)
    height = top.gather(0, highest)
    beside = sum(spots.roll(steps, (-2, -1))[..., REACH, REACH] for steps in ((0, 1), (0, -1), (1, 0), (-1, 0))) / 4
    share, spread, rough = top / height, beside / height, spots[..., ring].std(-1) / height.abs()
    differs = (spread - share * spread.gather(0, highest)).abs() > ALIKE + ROUGH * rough
    # Heights over the eight samples around, with the sign of the spot.
    around = (spots / height[..., None, None])[..., REACH - 1 : REACH + 2, REACH - 1 : REACH + 2].flatten(-2)
    sticks_out = share - around[..., [0, 1, 2, 3, 5, 6, 7, 8]].amax(-1) > SHARED
    # The shape of a clipped spot is unknown; a photosite clips one colour.
    is_clipped = colours[..., REACH, REACH] >= CLIPPED * colours.amax()
    # Channels that are equal are one colour: grey pictures that are stored as RGB.
    is_equal = (colours == colours.take_along_dim(highest[..., None, None], 0)).all(-1).all(-1)
    is_alike = sticks_out & ~is_equal & (~differs | is_clipped)
    return ~is_alike.any(0)


def sticking_as_far(places: Tensor, own: Tensor, heights: Tensor) -> Tensor:
    """Whether places [N, K, 7, 7] in other views have a spot like that of samples [K, 7, 7], within a pixel, [N, K]."""
    ring, middle = _ring(), slice(REACH - 1, REACH + 2)
    sign = torch.sign(own[:, REACH, REACH] - own[:, ring].median(-1).values)[:, None, None]
    # Above three quarters of the surroundings: half of them may lie beyond an edge.
    base = (sign * places)[..., ring].quantile(0.75, -1)
    return (sign * places)[..., middle, middle].flatten(2).amax(2) - base > UNCONFIRMED * heights


def _ring() -> Tensor:
    """The surroundings without the middle 3x3, which a mosaic may have spoilt, bool, [7, 7]."""
    return ~F.pad(torch.ones(3, 3, dtype=torch.bool), (REACH - 1,) * 4)


def is_unconfirmed(own: Tensor, others: Tensor, heights: Tensor) -> Tensor:
    """Whether the median of neighbours, `others`, shows nothing like `own` within a pixel, [K, 7, 7] twice -> [K]."""
    middle = slice(REACH - 1, REACH + 2)
    ring = _ring()
    sample, near = own[:, REACH, REACH].float(), others[:, middle, middle].flatten(1)
    beyond = torch.maximum(sample - near.amax(1), near.amin(1) - sample)
    detail, error = (
        surroundings.amax(1) - surroundings.amin(1) for surroundings in (own.float()[:, ring], (own - others)[:, ring])
    )
    is_new = beyond > UNCONFIRMED * heights
    is_clear = is_new & (heights > ABOVE_DETAIL * detail)
    # Also hot: a sample that exceeds 1.5 times the neighbours' disagreement, if over half of the candidates are such.
    # Otherwise this scene has detail of the kind, which neighbouring views sometimes miss.
    is_likely = is_clear | (is_new & (heights > ABOVE_ERROR * error))
    if int(is_likely.sum()) > max(FEW, len(heights) / 2):
        return is_likely
    return is_clear & (int(is_clear.sum()) > RARE * len(heights))


def with_spoilt(own: Tensor, others: Tensor, samples: Tensor, size: tuple[int, int]) -> Tensor:
    """The hot samples and those around them that they have spoilt, [K, 5]."""
    rest = own - others
    height = rest[:, REACH, REACH, None, None]
    is_spoilt = F.pad((rest / height)[:, 1:-1, 1:-1] > SPOILT, (1, 1, 1, 1))
    is_spoilt[:, REACH, REACH] = True
    index, row, column = is_spoilt.nonzero().unbind(1)
    spoilt = samples[index].clone()
    # Edges are repeated in the surroundings.
    spoilt[:, 3] = (spoilt[:, 3] + row - REACH).clamp(0, size[0] - 1)
    spoilt[:, 4] = (spoilt[:, 4] + column - REACH).clamp(0, size[1] - 1)
    return spoilt.unique(dim=0)


def heights_of(image: Tensor) -> Tensor:
    """Height of each inner sample of an image [H, W]; below 0: it lies within the range of its 8 neighbours."""

    def extreme(further: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
        beyond = further(image[:-2], image[2:])
        columns = further(beyond, image[1:-1])
        return further(further(columns[:, :-2], columns[:, 2:]), beyond[:, 1:-1])

    middle = image[1:-1, 1:-1]
    return torch.maximum(middle - extreme(torch.maximum), extreme(torch.minimum) - middle)


@dataclass(frozen=True, eq=False)
class BlackViewsDefect(Defect):
    """Views and corners without light."""

    name = "black_views"

    views: tuple[tuple[int, int], ...]  # row and column of each black view
    corners: Tensor | None  # which samples lie in black corners, [V, U, 1, H, W]; None: there are none

    def summary(self) -> str:
        """Number of black views, and share of black corners."""
        share = 0.0 if self.corners is None else float(self.corners.float().mean())
        texts = [counted(len(self.views), "black view")] if self.views else []
        texts += [f"black corners ({share:.1%})"] if share > 0 else []
        return f"{' and '.join(texts)} weigh nothing"

    def corrected(self, field: LightField) -> LightField:
        """The same views, weight 0 where they are black."""
        ones = field.views.new_ones(*field.grid, 1, *field.size)
        weight = ones if field.weight is None else field.weight.clone()
        if self.corners is not None:
            weight.masked_fill_(self.corners.to(weight.device), 0)
        for v, u in self.views:
            weight[v, u] = 0
        return dataclasses.replace(field, weight=weight)


def find_black(field: LightField) -> BlackViewsDefect | str:
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
    # Rows and columns from each corner of a view inwards.
    inwards = [torch.arange(max(1, int(LARGEST_CORNER * length))) for length in field.size]
    rows, columns = ((near, length - 1 - near) for near, length in zip(inwards, field.size, strict=True))
    places = [(..., row[:, None], column) for row in rows for column in columns]
    boxes = [_corner_region(_widened((field.views[place] < limit).all(2)).cpu()) for place in places]
    has_all = is_used & ~is_black & torch.stack([box.flatten(2).any(2) for box in boxes]).all(0)
    if not bool(has_all.any()):
        return BlackViewsDefect(black_views, None) if black_views else "all views have light in all corners"
    corners = torch.zeros(*field.grid, *field.size, dtype=torch.bool)
    for place, box in zip(places, boxes, strict=True):
        corners[place] = box & has_all[..., None, None]
    return BlackViewsDefect(black_views, corners[:, :, None])


def _corner_region(black: Tensor) -> Tensor:
    """The black corner at the first pixel, whose rows are at most as long as the row above them, bool, [V, U, h, w]."""
    # Number of black samples before the first one with light.
    runs = torch.where(black.all(-1), black.shape[-1], (~black).int().argmax(-1)).cummin(2).values
    depth = (runs > 0).sum(2)
    is_corner = (depth >= LEAST_CORNER) & (runs[..., 0] >= LEAST_CORNER)
    # A region that fills its box extends beyond the largest corner.
    is_corner &= (depth < black.shape[2]) & (runs[..., 0] < black.shape[3])
    region = (torch.arange(black.shape[3]) < runs[..., None]) & is_corner[..., None, None]
    return _widened(region)


def _widened(region: Tensor) -> Tensor:
    """A region [V, U, h, w] with the ring around it: bright samples between black ones, and dim ones beside them."""
    return F.max_pool2d(region.flatten(0, 1).float(), 2 * RIM + 1, 1, RIM).unflatten(0, region.shape[:2]) > 0
