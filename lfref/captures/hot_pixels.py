"""Hot and dead pixels: samples that stick out of all about them and that no neighbouring view knows of.

They are replaced by the mean of what is next to them, channel by channel: a weight of 0 would cost all of a field's
refocusing time for a handful of samples. What a mosaic has spread to neighbours goes with them.
Letters: `V U` view rows and columns, `C` channels, `K` samples; `v u c y x` their indices.
"""

import dataclasses
import itertools
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from lfref.captures import brightness
from lfref.captures.defect import Correction, Evidence
from lfref.functional import threads
from lfref.functional.jit import compiled, inlined
from lfref.lightfield import LightField

# PART hot_loop
# Compiled: samples that stick out of the eight about them, in one pass over pictures.
#
# Letters: `y x` pixel row and column.


@compiled
def spread(views: NDArray, channel: int, step: int) -> tuple[float, int]:
    """Sum and number of what samples of a channel stick out by, over every so many rows of pictures [B, C, H, W]."""
    scratch = np.empty((3, views.shape[3]), views.dtype)
    excess = scratch[2]
    total, count = 0.0, 0
    for n in range(views.shape[0]):
        plane = views[n, channel]
        for y in range(1, plane.shape[0] - 1, step):
            _excess(plane[y - 1], plane[y], plane[y + 1], scratch)
            for x in range(1, excess.size - 1):
                if excess[x] > 0:
                    total += excess[x]
                    count += 1
    return total, count


@compiled
def sticking_out(views: NDArray, channel: int, limit: float, found: NDArray, heights: NDArray) -> int:
    """Write picture, row, column [K, 3] of samples beyond a limit, and how far they stick out; how many, at most K."""
    scratch = np.empty((3, views.shape[3]), views.dtype)
    excess = scratch[2]
    least, count = views.dtype.type(limit), 0
    for n in range(views.shape[0]):
        plane = views[n, channel]
        for y in range(1, plane.shape[0] - 1):
            _excess(plane[y - 1], plane[y], plane[y + 1], scratch)
            n_out = 0
            for x in range(1, excess.size - 1):
                n_out += excess[x] > least
            if n_out == 0:
                continue
            for x in range(1, excess.size - 1):
                if excess[x] > least and count < len(found):
                    found[count, 0], found[count, 1], found[count, 2], heights[count] = n, y, x, excess[x]
                    count += 1
    return count


@inlined
def _larger(a: float, b: float) -> float:
    # The built-in one looks for NaN, and then does not run on vectors.
    return a if a > b else b


@inlined
def _smaller(a: float, b: float) -> float:
    return a if a < b else b


@compiled
def _excess(above: NDArray, row: NDArray, below: NDArray, scratch: NDArray) -> None:
    """How far each sample of a row is above or below all about it, scratch[2]; less than 0: it is among them."""
    high, low, excess = scratch[0], scratch[1], scratch[2]
    for x in range(row.size):
        high[x] = _larger(_larger(above[x], below[x]), row[x])
        low[x] = _smaller(_smaller(above[x], below[x]), row[x])
    for x in range(1, row.size - 1):
        most = _larger(_larger(high[x - 1], high[x + 1]), _larger(above[x], below[x]))
        least = _smaller(_smaller(low[x - 1], low[x + 1]), _smaller(above[x], below[x]))
        excess[x] = _larger(row[x] - most, least - row[x])


FAR = 12.0  # times as far as samples stick out on average: one maximum in e^12 of noise does
LEAST = 0.02  # of the brightest samples: less does not show
KNOWN = 0.5  # of its height, that a neighbouring view may not confirm
LOCAL = 1.3  # times the range of what is about it: what lies among detail does not show, and may be detail
MOST = 1 << 13  # samples of a channel: more are texture
REACH = 3  # pixels that a look at a sample goes about it
HALO = 0.15  # of the height, from which on samples beside a hot one are spoilt by it
WRONG = 1.5  # times the range of what neighbouring views are wrong by there: enough where
MOSTLY = 0.5  # of what sticks out in a view is not known to others
FEW = 3  # samples that may be chance
HARDLY = 0.01  # of it: so few may be detail, whatever they look like
NEAR = 0.6  # pixels, standard deviation of the weights of what a hot sample is replaced by
WORTH_A_THREAD = 1 << 18  # samples
ROWS = 8  # every so many rows tell how far samples stick out


@dataclass(frozen=True, eq=False)
class HotPixels:
    """Which samples are hot, or dead."""

    name: ClassVar[str] = "hot_pixels"

    places: Tensor
    """View row and column, channel, pixel row and column of each, [K, 5]."""
    count: int
    """How many there are, without those that they have spoilt."""

    def inert(self) -> str | None:
        """Nothing changes where there is none."""
        return None if self.count else "no sample sticks out that other views do not confirm"

    def told(self) -> str:
        """How many."""
        return f"{self.count} hot or dead samples take the mean of what is next to them"

    def corrected(self, field: LightField) -> LightField:
        """The samples replaced."""
        is_hot = torch.zeros(field.views.shape, dtype=torch.bool)
        is_hot[self.places.unbind(1)] = True
        about, weight = _patches(field.views, self.places), _nearness() * ~_patches(is_hot, self.places)
        weight = weight.to(about)
        mean = (weight * about).sum((1, 2)) / weight.sum((1, 2)).clamp(min=1e-12)
        views = field.views.clone()
        views[self.places.unbind(1)] = mean
        return dataclasses.replace(field, views=views)


def find(evidence: Evidence) -> HotPixels:
    """Find hot and dead pixels.

    Args:
        evidence: Of the light field.
    """
    none = HotPixels(torch.zeros(0, 5, dtype=torch.long), 0)
    views = evidence.field.views
    if views.shape[0] * views.shape[1] < 3 or min(views.shape[-2:]) < 2 * REACH + 1:
        return none
    places, heights = _candidates(views)
    if not len(places):
        return none
    disparity, steps = evidence.disparity.cpu(), _from_reference(evidence)
    own, others = _patches(views, places), _predicted(views, places, disparity, steps)
    is_hot = _unconfirmed(own, others, heights)
    if not bool(is_hot.any()):
        return none
    spoilt = _spoilt(own[is_hot], others[is_hot], places[is_hot], evidence.field.size)
    return HotPixels(spoilt, int(is_hot.sum()))


def _candidates(views: Tensor) -> tuple[Tensor, Tensor]:
    """Samples that stick out of their own view, [K, 5], and by how much, [K]."""
    images = views.detach().float().cpu().flatten(0, 1).contiguous().numpy()
    found = [_in_channel(images, c) for c in range(images.shape[1])]
    places, heights = (torch.cat(parts) for parts in zip(*found, strict=True))
    v, u = places[:, 0] // views.shape[1], places[:, 0] % views.shape[1]
    return torch.cat([torch.stack([v, u], 1), places[:, 1:]], 1), heights


def _in_channel(images: NDArray, channel: int) -> tuple[Tensor, Tensor]:
    """Likewise of one channel of pictures [VU, C, H, W], with the number of the view first, [K, 4] and [K]."""
    total, count = spread(images, channel, ROWS)
    bright = float(np.quantile(images[:, channel, ::ROWS, ::ROWS], 0.99))
    limit = max(FAR * total / max(count, 1), LEAST * bright)
    found: list[tuple[NDArray, NDArray]] = []

    def look(first: int, last: int) -> None:
        places, heights = np.empty((MOST, 3), np.int64), np.empty(MOST, np.float32)
        n = sticking_out(images[first:last], channel, limit, places, heights)
        found.append((places[:n] + np.array([first, 0, 0]), heights[:n]))

    jobs = threads.bands(len(images), threads.worthwhile(images[:, 0].size, WORTH_A_THREAD))
    threads.share(look, jobs, len(jobs))
    places = torch.from_numpy(np.concatenate([each for each, _ in found]))
    heights = torch.from_numpy(np.concatenate([each for _, each in found]))
    if len(places) >= MOST or not np.isfinite(limit):
        places, heights = places[:0], heights[:0]
    return torch.cat([places[:, :1], torch.full_like(places[:, :1], channel), places[:, 1:]], 1), heights


def _patches(views: Tensor, places: Tensor) -> Tensor:
    """What is about each place, mirrored nowhere: beyond the edge its pixels go on, [K, 2 REACH + 1, 2 REACH + 1]."""
    v, u, c, y, x = places.unbind(1)
    around = torch.arange(-REACH, REACH + 1)
    rows = (y[:, None] + around).clamp(0, views.shape[-2] - 1)
    columns = (x[:, None] + around).clamp(0, views.shape[-1] - 1)
    index = [each[:, None, None] for each in (v, u, c)]
    return views[(*index, rows[:, :, None], columns[:, None, :])]


def _from_reference(evidence: Evidence) -> Tensor:
    """Rows and columns of all views in view steps from that which disparities are of, [2, V, U]."""
    steps, (v, u) = brightness.view_places(evidence.field).float().cpu(), evidence.reference
    return steps - steps[:, v, u, None, None]


def _predicted(views: Tensor, places: Tensor, disparity: Tensor, steps: Tensor) -> Tensor:
    """What the neighbouring views show there, the median of them, [K, ...] as `_patches`."""
    shown = [_patches(views, moved) for moved in _neighbours(views.shape, places, disparity, steps)]
    return torch.stack(shown).float().nanquantile(0.5, 0)


def _neighbours(shape: torch.Size, places: Tensor, disparity: Tensor, steps: Tensor) -> list[Tensor]:
    """Places in the views about each view; in a view itself where it has no such neighbour, those on the other side."""
    n_rows, n_columns, _, height, width = shape
    v, u, c, y, x = places.unbind(1)
    q, p = steps[:, v, u]
    d = disparity[y, x]
    row = (y - d * q).round().long().clamp(0, height - 1)
    column = (x - d * p).round().long().clamp(0, width - 1)
    d = disparity[row, column]
    moves = []
    for down, across in itertools.product((-1, 0, 1), repeat=2):
        if (down, across) == (0, 0) or (down and n_rows == 1) or (across and n_columns == 1):
            continue
        to_v = torch.where((v + down >= 0) & (v + down < n_rows), v + down, v - down).clamp(0, n_rows - 1)
        to_u = torch.where((u + across >= 0) & (u + across < n_columns), u + across, u - across).clamp(0, n_columns - 1)
        down_by, across_by = steps[:, to_v, to_u] - steps[:, v, u]
        to_y, to_x = (y + d * down_by).round().long(), (x + d * across_by).round().long()
        moves.append(torch.stack([to_v, to_u, c, to_y.clamp(0, height - 1), to_x.clamp(0, width - 1)], 1))
    return moves


def _nearness() -> Tensor:
    """How far each sample of a patch counts for its middle, by its distance, [2 REACH + 1, 2 REACH + 1]."""
    offsets = torch.arange(-REACH, REACH + 1).square().double()
    return (-(offsets[:, None] + offsets) / (2 * NEAR**2)).exp()


def _unconfirmed(own: Tensor, others: Tensor, heights: Tensor) -> Tensor:
    """Whether neighbouring views show nothing of the kind, within a pixel, [K]."""
    middle = slice(REACH - 1, REACH + 2)
    sample, near = own[:, REACH, REACH].float(), others[:, middle, middle].flatten(1)
    beyond = torch.maximum(sample - near.amax(1), near.amin(1) - sample)
    detail, error = (_range(each[:, _ring()]) for each in (own.float(), own - others))
    is_new = beyond > KNOWN * heights
    is_clear = is_new & (heights > LOCAL * detail)
    is_likely = is_clear | (is_new & (heights > WRONG * error))
    # Detail that neighbouring views confirm tells that this scene has more of the kind, which they may miss.
    if int(is_likely.sum()) > max(FEW, MOSTLY * len(heights)):
        return is_likely
    return is_clear & (int(is_clear.sum()) > HARDLY * len(heights))


def _range(samples: Tensor) -> Tensor:
    return samples.amax(1) - samples.amin(1)


def _ring() -> Tensor:
    """Samples of a patch but its middle, which a mosaic may have spoilt."""
    middle = F.pad(torch.ones(3, 3, dtype=torch.bool), (REACH - 1,) * 4)
    return ~middle


def _spoilt(own: Tensor, others: Tensor, places: Tensor, size: tuple[int, int]) -> Tensor:
    """The hot samples and those beside them that they have spoilt, [K, 5]."""
    rest = own - others
    height = rest[:, REACH, REACH, None, None]
    is_spoilt = F.pad((rest / height)[:, 1:-1, 1:-1] > HALO, (1, 1, 1, 1))
    is_spoilt[:, REACH, REACH] = True
    index, row, column = is_spoilt.nonzero().unbind(1)
    moved = places[index].clone()
    moved[:, 3] += row - REACH
    moved[:, 4] += column - REACH
    inside = (moved[:, 3:] >= 0).all(1) & (moved[:, 3] < size[0]) & (moved[:, 4] < size[1])
    return moved[inside].unique(dim=0)


HOT_PIXELS = Correction(HotPixels, "neighbouring views", find)
