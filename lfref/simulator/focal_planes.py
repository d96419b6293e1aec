"""What the picture of a plane needs: visible layers, cells of the aperture, and blurs within a cell.

The aperture of a lens spans the cells of all views, U x V view steps; a disc is the inscribed ellipse. It is cut into
equal cells that are nearly square. Each cell shows every surface as it looks from the cell's middle, blurred by the
distance that the surface moves within the cell: a box of |e| times the cell's side. In the plane of slope s, a bitmap
of disparity d that faces the camera is read at x + e p, where e = s - d. All aperture points together therefore see the
part of the bitmap under the central view, and a margin around that part.
The module stands apart from `truth`, which alone uses it, because it decides how exact a truth is. Its choices are
tested by numbers, not by pictures.
Letters: `p q` aperture column and row in view steps, `J I` rows and columns of cells, `e` relative slope in pixels per
view step, `K` layers from far to near, `h w` rows and columns in samples, `T` steps of |e|.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref import geometry
from lfref.simulator import bitmaps
from lfref.simulator.bitmaps import OVERSAMPLING, Bitmap
from lfref.simulator.layers import Layer, crossing_pairs, disparity_span, only_shifts
from lfref.simulator.scene import Camera

CELLS_PER_ROOT = {"square": 1.2, "disc": 2.0}
"""Factor k of the number of cells along a side, 1 + k sqrt(blur in pixels). With it, the worst plane of sim30 is 48 dB
from 64 x 64 points (table in docs/simulator.md). A disc needs more cells, since they do not follow its edge."""
CELLS_OF_ONE_LAYER = 24
"""Number of cells along a side for a single layer that is only shifted. With it, waves of up to 0.3 cycles per pixel
are at least 58 dB from closed forms. The cells cost nothing, since their sum is one filter."""
HIGHLIGHT_STEP = 1.5
"""Greatest movement of a highlight over its surface within a cell, in standard deviations of the highlight."""


@dataclass(frozen=True, eq=False)
class Cells:
    """A grid of cells that covers an aperture."""

    p: Tensor  # columns of cell centres in view steps, float64, [I]
    q: Tensor  # rows of cell centres in view steps, float64, [J]
    weights: Tensor  # share of the open aperture in each cell, float64, [J, I]; their sum is 1
    height: float  # height of one cell in view steps
    width: float


def cut_aperture(camera: Camera, n_cells: int) -> Cells:
    """Cut the aperture into cells, `n_cells` along its longer side; cells outside of a disc have the weight 0."""
    sides = camera.grid
    counts = [max(1, math.ceil(n_cells * side / max(sides) - 1e-9)) for side in sides]
    edges_q, edges_p = (torch.linspace(-1, 1, count + 1, dtype=torch.float64) for count in counts)
    if camera.aperture == "disc":
        area = geometry.covered_by_disc(edges_q, edges_p)
    else:
        area = edges_q.diff()[:, None] * edges_p.diff()
    q, p = ((edge[1:] + edge[:-1]) / 4 * side for edge, side in zip((edges_q, edges_p), sides, strict=True))
    height, width = (side / count for side, count in zip(sides, counts, strict=True))
    return Cells(p, q, area / area.sum(), height, width)


def cells_needed(layers: Sequence[Layer], camera: Camera, slope: float) -> int:
    """Number of cells along a side of the aperture that a plane needs.

    If one layer moves and all others are in focus, the blur of a cell is right however far that layer moves. If two
    layers move, they must not move far within a cell: the second fastest layer decides. On a disc the fastest decides,
    since cells do not follow its edge. A highlight may move over its surface by a part of its width within a cell.
    """
    if len(layers) == 1 and only_shifts(layers[0].surface):
        return CELLS_OF_ONE_LAYER
    speeds = []
    for layer in layers:
        ends = [*layer.surface.geometry.disparity_range(camera.size)]
        if layer.reflection and layer.reflection.share > 0:
            ends.append(layer.reflection.disparity)
        speeds.append(max(abs(end - slope) for end in ends))
    fastest = sorted(speeds)[-1 if camera.aperture == "disc" else -2 :]
    blur = max(camera.grid) * (fastest[0] if fastest else 0.0)
    counts = [1 + math.ceil(CELLS_PER_ROOT[camera.aperture] * math.sqrt(blur) - 1e-9)]
    for layer in layers:
        if layer.highlight:
            steps = abs(layer.highlight.drift) / (HIGHLIGHT_STEP * layer.highlight.width)
            counts.append(math.ceil(max(camera.grid) * steps - 1e-9))
    return max(counts)


class CellFilter(NamedTuple):
    """Look-ups of a bitmap that faces the camera: blurred within a cell, and read at one position for each cell."""

    down: NDArray[np.float64]  # taps along a column
    across: NDArray[np.float64]  # taps along a row
    rows: NDArray[np.float64]  # row that pixel 0 reads through each row of cells, in samples of the window, [J]
    columns: NDArray[np.float64]  # column that pixel 0 reads through each column of cells, [I]


def cell_filter(e: float, cells: Cells, margin: int) -> CellFilter:
    """The filter of a bitmap of relative slope e, in a window with `margin` pixels around the central view."""
    rows, columns = (OVERSAMPLING * (margin + e * centres.numpy()) for centres in (cells.q, cells.p))
    speed = OVERSAMPLING * abs(e)
    return CellFilter(box_taps(speed * cells.height, rows), box_taps(speed * cells.width, columns), rows, columns)


def box_taps(width: float, positions: NDArray) -> NDArray:
    """Taps of sum 1, symmetric and odd in number, that act as a box of some width in samples.

    The box is integrated over each sample. This integration and the linear look-ups at `positions` add a little blur. A
    kernel (-excess / 2, 1 + excess, -excess / 2) removes its variance, so that taps and look-ups together have the
    variance of the box, width^2 / 12.
    """
    half = max(width, 1) / 2
    # Sample n covers n - 1/2 to n + 1/2: its tap is the part of this range within the box.
    n = np.arange(-math.ceil(half - 0.5), math.ceil(half - 0.5) + 1)
    box = np.minimum(n + 0.5, half) - np.maximum(n - 0.5, -half)
    box /= box.sum()
    share = positions % 1
    excess = (box * n**2).sum() + (share * (1 - share)).mean() - width**2 / 12
    return np.convolve(box, [-excess / 2, 1 + excess, -excess / 2])


def combined_taps(taps: NDArray, positions: NDArray, weights: NDArray) -> tuple[int, NDArray]:
    """First sample and taps of one filter that equals a filter and a weighted sum of linear look-ups after it."""
    whole = np.floor(positions).astype(int)
    first, share = whole.min(), positions - whole
    look_ups = np.zeros(whole.max() - first + 2)
    np.add.at(look_ups, whole - first, weights * (1 - share))
    np.add.at(look_ups, whole - first + 1, weights * share)
    return int(first) - len(taps) // 2, np.convolve(look_ups, taps)


@dataclass(eq=False)
class Windows:
    """Parts of bitmaps that the planes of a stack see, cut once for all planes; the bitmaps face the camera."""

    camera: Camera
    margin: int  # greatest margin of any plane around the central view, in pixels
    _samples: dict[Bitmap, Tensor] = field(default_factory=dict)

    def cut(self, bitmap: Bitmap, margin: int) -> Tensor:
        """Samples under the central view and a margin around it, edge samples repeated beyond the bitmap, [4, h, w]."""
        if bitmap not in self._samples:
            self._samples[bitmap] = bitmap.window(self.camera.size, self.margin)
        samples = self._samples[bitmap]
        unused = (self.margin - margin) * OVERSAMPLING
        return samples[:, unused : samples.shape[1] - unused, unused : samples.shape[2] - unused]


@dataclass(frozen=True, eq=False)
class FocalPlane:
    """One plane to be photographed."""

    slope: float  # slope in pixels per view step
    camera: Camera
    layers: tuple[Layer, ...]  # visible layers from far to near
    cells: Cells
    margin: int  # pixels around the central view that the plane sees of bitmaps that face the camera
    windows: Windows

    @property
    def is_sorted(self) -> bool:
        """Whether layers are sorted by depth at each pixel."""
        return any(layer.is_sorted for layer in self.layers)

    @property
    def traced(self) -> tuple[Layer, ...]:
        """Layers whose rays are followed one by one: all of them if they are sorted."""
        return tuple(layer for layer in self.layers if layer.is_traced or self.is_sorted)

    @property
    def cell_width(self) -> float:
        """Mean side of a cell in view steps."""
        return (self.cells.height + self.cells.width) / 2

    def window(self, bitmap: Bitmap) -> Tensor:
        """Samples of a bitmap that faces the camera, [4, h, w]."""
        return self.windows.cut(bitmap, self.margin)

    def window_corner(self) -> tuple[int, int]:
        """Y and X of the first sample of a window, in samples."""
        top, left = (-(length - 1) - self.margin * OVERSAMPLING for length in self.camera.size)
        return top, left

    def filter(self, disparity: float) -> CellFilter:
        """The filter of a bitmap that faces the camera."""
        return cell_filter(self.slope - disparity, self.cells, self.margin)

    def crosses(self) -> NDArray[np.bool_]:
        """Pairs of layers that cross, [K, K]."""
        marks = np.zeros((len(self.layers),) * 2, np.bool_)
        for far, near in _crossing(self.layers, self.camera, self.slope):
            marks[far, near] = marks[near, far] = True
        return marks

    def blur_levels(self, layer: Layer) -> tuple[NDArray[np.float64], float]:
        """Levels of the blurred copies of a traced layer's bitmap that suit each relative slope.

        Returns the level, with its fraction, at 256 even steps of |e| from 0 on, and the number of steps per unit of
        |e|. The window of a layer that faces the camera is already blurred: all levels are 0.
        """
        n_steps = 256
        if layer.surface.geometry.is_parallel:
            return np.zeros(n_steps), 0.0
        ends = disparity_span(self.camera, layer.surface.geometry, abs(self.slope))
        farthest = max(abs(self.slope - end) for end in ends)
        # The table of a layer that is in focus everywhere must span more than 0, too.
        e = np.linspace(0, max(farthest, 1e-6), n_steps)
        # A box of width w has the variance w^2 / 12. The linear look-ups through all cells add a part of it: t (1 - t)
        # at a fraction t of a sample. The copies add the rest.
        box = (e * self.cell_width * OVERSAMPLING) ** 2 / 12
        shares = [(OVERSAMPLING * e[:, None] * centres.numpy()) % 1 for centres in (self.cells.q, self.cells.p)]
        look_ups = sum((share * (1 - share)).mean(1) for share in shares) / 2
        return bitmaps.levels(box - look_ups), (n_steps - 1) / float(e[-1])


def focal_planes(
    layers: Sequence[Layer], camera: Camera, slopes: Sequence[float], n_cells: int | None = None
) -> list[FocalPlane]:
    """The planes of a stack, each with its visible layers and the cells that it needs, or `n_cells` along a side."""
    windows = Windows(camera, max(_margin(layers, camera, slope) for slope in slopes))
    planes = []
    for slope in slopes:
        visible = visible_layers(layers, slope, windows)
        cells = cut_aperture(camera, n_cells or cells_needed(visible, camera, slope))
        planes.append(FocalPlane(slope, camera, visible, cells, _margin(visible, camera, slope), windows))
    return planes


def _margin(layers: Sequence[Layer], camera: Camera, slope: float) -> int:
    """Margin around the central view, in pixels, that a plane reads in bitmaps that face the camera."""
    disparities: list[float] = []
    for layer in layers:
        if layer.surface.geometry.is_parallel:
            disparities.append(layer.surface.geometry.form.disparity)
        if layer.reflection:
            disparities.append(layer.reflection.disparity)
    farthest = max((abs(slope - disparity) for disparity in disparities), default=0.0)
    # The box of a cell ends there; its filter and the look-ups reach up to four samples, or 2 pixels, further.
    return math.ceil(farthest * max(camera.grid) / 2) + 3


def _crossing(layers: Sequence[Layer], camera: Camera, slope: float) -> list[tuple[int, int]]:
    return crossing_pairs([layer.surface.geometry for layer in layers], camera, abs(slope))


def visible_layers(layers: Sequence[Layer], slope: float, windows: Windows) -> tuple[Layer, ...]:
    """Layers that contribute to a plane: neither transparent all over, nor behind a layer that is opaque all over.

    A layer with an edge may still be opaque in the part that this plane sees. A layer that crosses an opaque layer is
    in front of it somewhere.
    """
    crossing = _crossing(layers, windows.camera, slope)
    margin = _margin(layers, windows.camera, slope)
    visible: list[int] = []
    opaque: list[int] = []
    for k in reversed(range(len(layers))):
        if any((k, nearer) not in crossing for nearer in opaque):
            continue
        is_parallel, bitmap = layers[k].surface.geometry.is_parallel, layers[k].bitmap
        opacity = (windows.cut(bitmap, margin) if is_parallel else bitmap.samples)[3]
        # On the CPU by NumPy: PyTorch's threads would wait for each other where several processes share the cores.
        values = opacity.numpy() if opacity.device.type == "cpu" else opacity
        if float(values.max()) > 0:
            visible.append(k)
        # Float32 products of opacities may miss 1 by some roundings.
        if float(values.min()) > 1 - 1e-6:
            opaque.append(k)
    return tuple(layers[k] for k in reversed(visible))
