"""Pictures that face the camera, blurred by the way that they move within a cell of the aperture.

Letters: `e` relative slope in pixels per view step, `o` samples a pixel, `J I` rows and columns of cells.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.functional import cells
from lfref.simulator import blurs, layers
from lfref.simulator.blurs import Bitmap
from lfref.simulator.canvases import OVERSAMPLING
from lfref.simulator.layers import Layer
from lfref.simulator.scene import Camera

# PART aperture_cells
# The aperture of a lens cut into cells: where each lies, how much of it is open, how many are needed.
#
# An aperture spans the views' cells, U x V view steps; a disc is the ellipse inscribed. Cells are of one size and as
# nearly square as whole numbers of them allow.
# Letters: `p q` aperture column and row in view steps, `U V` its width and height, `j i` row and column of cells.

CELLS_PER_ROOT = {"square": 1.2, "disc": 2.0}
"""Cells a side for a blur of 1 px beside the first one; they grow with its root. A disc's edge is not that of cells."""


@dataclass(frozen=True)
class Aperture:
    """The opening of a lens."""

    shape: str
    """`square` or `disc`."""
    height: float
    """V in view steps."""
    width: float
    """U in view steps."""

    @property
    def extent(self) -> float:
        """The longer side in view steps."""
        return max(self.height, self.width)


@dataclass(frozen=True, eq=False)
class Cells:
    """A grid of cells that covers an aperture."""

    p: Tensor
    """Columns of cell centres in view steps, float64, [I]."""
    q: Tensor
    """Rows of cell centres in view steps, float64, [J]."""
    weights: Tensor
    """Share of the open aperture that each cell holds, of sum 1, float64, [J, I]."""
    height: float
    """Of one cell in view steps."""
    width: float
    """Of one cell in view steps."""


def aperture(camera: Camera) -> Aperture:
    """The aperture of a camera: the cells of its views."""
    return Aperture(camera.aperture, *map(float, camera.grid))


def cut(whole: Aperture, n_cells: int) -> Cells:
    """Cut an aperture into cells.

    Args:
        whole: The aperture.
        n_cells: Cells along its longer side, at least 1.

    Returns:
        The cells, those that are shut included.
    """
    sides = (whole.height, whole.width)
    counts = [max(1, math.ceil(n_cells * side / whole.extent - 1e-9)) if side > 0 else 1 for side in sides]
    edges = [torch.linspace(-1, 1, count + 1, dtype=torch.float64) for count in counts]
    area = _AREAS[whole.shape](*edges)
    q, p = ((edge[1:] + edge[:-1]) / 4 * side for edge, side in zip(edges, sides, strict=True))
    height, width = (side / count for side, count in zip(sides, counts, strict=True))
    return Cells(p, q, area / area.sum(), height, width)


def needed(whole: Aperture, speeds: Sequence[float]) -> int:
    """How many cells a side resolve what surfaces hide of each other.

    A blur within cells stands for a surface that moves while others stand still, however far; two that move at once
    must not move far within a cell. On a disc one that moves is enough. A surface alone gets as many as two alike.

    Args:
        whole: The aperture.
        speeds: Pixels that each surface moves per view step, at least 0.
    """
    both = sorted(speeds)[-1 if whole.shape == "disc" else -2 :]
    joint = both[0] if both else 0.0
    return 1 + math.ceil(CELLS_PER_ROOT[whole.shape] * math.sqrt(whole.extent * joint) - 1e-9)


def _rectangle(edges_q: Tensor, edges_p: Tensor) -> Tensor:
    """Open area of each cell of a square of side 2 about 0, [J + 1], [I + 1] -> [J, I]."""
    return edges_q.diff()[:, None] * edges_p.diff()


_AREAS: dict[str, Callable[[Tensor, Tensor], Tensor]] = {"square": _rectangle, "disc": cells.of_disc}


class Filter(NamedTuple):
    """How a picture is blurred within a cell, and where it is then read through every cell."""

    down: NDArray[np.float64]
    """Taps along a column."""
    across: NDArray[np.float64]
    """Taps along a row."""
    rows: NDArray[np.float64]
    """What pixel 0 reads through each row of cells, in samples of a plane's window, [J]."""
    columns: NDArray[np.float64]
    """Likewise through each column of cells, [I]."""


def cell_filter(e: float, cells: Cells, margin: int) -> Filter:
    """The filter of a picture.

    Args:
        e: Its relative slope.
        cells: Of the aperture.
        margin: Pixels that the window goes beyond the central view.
    """
    rows, columns = (OVERSAMPLING * (margin + e * centres.numpy()) for centres in (cells.q, cells.p))
    way = OVERSAMPLING * abs(e)
    return Filter(box_taps(way * cells.height, rows), box_taps(way * cells.width, columns), rows, columns)


def box_taps(width: float, positions: NDArray) -> NDArray:
    """A filter that, together with linear look-ups at some positions, has the variance of a box.

    Args:
        width: Of the box in samples.
        positions: Of the look-ups in samples.

    Returns:
        Taps of sum 1, symmetric, odd in number.
    """
    half = max(width, 1) / 2
    n = np.arange(-math.ceil(half - 0.5), math.ceil(half - 0.5) + 1)
    box = np.minimum(n + 0.5, half) - np.maximum(n - 0.5, -half)
    box /= box.sum()
    share = positions % 1
    excess = (box * n**2).sum() + (share * (1 - share)).mean() - width**2 / 12
    return np.convolve(box, [-excess / 2, 1 + excess, -excess / 2])


def linear_variance(e: NDArray, cells: Cells) -> NDArray:
    """What linear look-ups through all cells blur on average, the mean of both axes.

    Args:
        e: Relative slopes, [T].
        cells: Of the aperture.

    Returns:
        Variances in samples squared, [T].
    """
    shares = [(OVERSAMPLING * e[:, None] * centres.numpy()) % 1 for centres in (cells.q, cells.p)]
    return sum((share * (1 - share)).mean(1) for share in shares) / 2


def summed(taps: NDArray, positions: NDArray, weights: NDArray) -> tuple[int, NDArray]:
    """Filter and linear look-ups at several positions as one filter.

    Args:
        taps: Of the filter, odd in number.
        positions: Of the look-ups in samples.
        weights: Of each.

    Returns:
        Sample that the first tap reads, and the taps.
    """
    whole = np.floor(positions).astype(int)
    first, share = whole.min(), positions - whole
    spread = np.zeros(whole.max() - first + 2)
    np.add.at(spread, whole - first, weights * (1 - share))
    np.add.at(spread, whole - first + 1, weights * share)
    return int(first) - len(taps) // 2, np.convolve(spread, taps)


# PART scenery
# Layers as the planes of a stack look at them, and which of them show.
#
# A picture of disparity d that faces the camera is seen at x + e p in the plane of slope s, e = s - d: every aperture
# point only shifts what the central view sees of it, and what lies around that.
# Letters: `K` layers from far to near, `h w` rows and columns in samples, `e` relative slope.

MARGIN = 3
"""Pixels beyond the farthest blur, where filters end."""
OPAQUE = 1 - 1e-6
STEPS = 256
"""Of |e|, at which blurs are tabulated."""
LEAST = 1e-6
"""Pixels per view step that tables of |e| go to at least."""


@dataclass(frozen=True, eq=False)
class Scenery:
    """What there is to photograph."""

    layers: tuple[Layer, ...]
    """From far to near."""
    camera: Camera
    whole: Aperture
    """As far as it is open."""
    margin: int = 0
    """Pixels around the central view that any plane looks at."""
    _windows: dict[Bitmap, Tensor] = field(default_factory=dict)

    def for_planes(self, slopes: Sequence[float]) -> "Scenery":
        """With the margin that planes of these slopes need."""
        return replace(self, margin=max(map(self.margin_at, slopes)))

    def only(self, kept: Sequence[int]) -> "Scenery":
        """Some of the layers, in their order."""
        return replace(self, layers=tuple(self.layers[k] for k in kept))

    def margin_at(self, slope: float) -> int:
        """Pixels around the central view that a plane looks at of pictures that face the camera."""
        disparities = [disparity for layer in self.layers for disparity in _facing(layer)]
        farthest = max((abs(slope - disparity) for disparity in disparities), default=0.0)
        return math.ceil(farthest * self.whole.extent / 2) + MARGIN

    def window(self, bitmap: Bitmap, slope: float) -> Tensor:
        """Samples of a picture that faces the camera which a plane looks at, its ends going on beyond it, [4, h, w]."""
        if bitmap not in self._windows:
            self._windows[bitmap] = bitmap.window(self.camera.size, self.margin)
        samples = self._windows[bitmap]
        cut = (self.margin - self.margin_at(slope)) * OVERSAMPLING
        return samples[:, cut : samples.shape[1] - cut, cut : samples.shape[2] - cut]

    def corner(self, slope: float) -> tuple[int, int]:
        """Y and X of a window's first sample, in samples."""
        top, left = (-(length - 1) - self.margin_at(slope) * OVERSAMPLING for length in self.camera.size)
        return top, left

    def crossing(self, slope: float) -> list[tuple[int, int]]:
        """Pairs of layers, the farther first, of which each is before the other somewhere in a plane."""
        return layers.crossing([layer.surface.geometry for layer in self.layers], self.camera, abs(slope))


def _facing(layer: Layer) -> list[float]:
    """Disparities of a layer's pictures that face the camera."""
    geometry, reflection = layer.surface.geometry, layer.reflection
    return [geometry.form.disparity] * geometry.is_parallel + ([reflection.disparity] if reflection else [])


def visible(scenery: Scenery, slope: float) -> list[int]:
    """Layers that show in a plane: not transparent all over, and not behind one that is opaque all over.

    Args:
        scenery: All layers.
        slope: Of the plane.
    """
    crossing = scenery.crossing(slope)
    kept: list[int] = []
    opaque: list[int] = []
    for k in reversed(range(len(scenery.layers))):
        if any((k, nearer) not in crossing for nearer in opaque):
            continue
        low, high = _opacity_range(scenery, k, slope)
        kept = [k, *kept] if high > 0 else kept
        opaque += [k] if low > OPAQUE else []
    return kept


def _opacity_range(scenery: Scenery, k: int, slope: float) -> tuple[float, float]:
    layer = scenery.layers[k]
    is_parallel = layer.surface.geometry.is_parallel
    opacity = (scenery.window(layer.bitmap, slope) if is_parallel else layer.bitmap.samples)[3]
    if opacity.device.type == "cpu":
        values = opacity.numpy()  # NumPy: no threads that wait for each other
        return float(values.min()), float(values.max())
    return float(opacity.min()), float(opacity.max())


class FocalPlane(NamedTuple):
    """How one plane is photographed."""

    slope: float
    """In pixels per view step."""
    seen: Scenery
    """What shows in it."""
    cells: Cells
    """Of the aperture."""

    @property
    def is_sorted(self) -> bool:
        """Whether layers are put in their order at each pixel."""
        return any(layer.is_sorted for layer in self.seen.layers)

    @property
    def followed(self) -> tuple[Layer, ...]:
        """Layers whose rays are followed one by one; if layers are sorted, all of them."""
        return tuple(layer for layer in self.seen.layers if layer.is_traced or self.is_sorted)

    @property
    def cell(self) -> float:
        """Width of a cell in view steps, the mean of both sides."""
        return (self.cells.height + self.cells.width) / 2

    def crosses(self) -> NDArray[np.bool_]:
        """Pairs of layers that cross, [K, K]."""
        marks = np.zeros((len(self.seen.layers),) * 2, np.bool_)
        for far, near in self.seen.crossing(self.slope):
            marks[far, near] = marks[near, far] = True
        return marks

    def blurs(self, layer: Layer) -> tuple[NDArray[np.float64], float]:
        """Which blurred copies a followed layer is read from.

        Args:
            layer: The layer.

        Returns:
            Levels of its bitmap at even steps of |e| from 0 on, or 0 where it faces the camera and has one blur, [T];
            steps for each unit of |e|.
        """
        if layer.surface.geometry.is_parallel:
            return np.zeros(STEPS), 0.0
        ends = layers.span(self.seen.camera, layer.surface.geometry, abs(self.slope))
        farthest = max(abs(self.slope - end) for end in ends)
        e = np.linspace(0, max(farthest, LEAST), STEPS)
        box = (e * self.cell * OVERSAMPLING) ** 2 / 12
        return blurs.levels(box - linear_variance(e, self.cells)), (STEPS - 1) / float(e[-1])
