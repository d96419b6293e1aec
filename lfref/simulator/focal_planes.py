"""What the picture of a plane needs: visible layers, cells of the aperture, and blurs within a cell.

The aperture of a lens spans the cells of all views, U x V view steps; a disc is the inscribed ellipse. It is cut into
equal cells that are nearly square. Each cell shows every surface as it looks from the cell's middle, blurred by the
distance that the surface moves within the cell: a box of |e| times the cell's side. In the plane of slope s, a bitmap
of disparity d that faces the camera is read at x + e p, where e = s - d. All aperture points together therefore see the
part of the bitmap under the central view, and a margin around that part.
Letters: `p q` aperture column and row in view steps, `J I` rows and columns of cells, `e` relative slope in pixels per
view step, `K` layers from far to near, `h w` rows and columns in samples, `T` steps of |e|.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref import geometry
from lfref.simulator import bitmaps
from lfref.simulator.bitmaps import FINE, OVERSAMPLING, Bitmap, CopyBlur
from lfref.simulator.layers import Layer, crossing_pairs, disparity_span, only_shifts
from lfref.simulator.scene import Camera

SMOOTH = 20.0
"""Blur in pixels at which the bound is half of the camera's `truth_error`. A wide blur is smooth, so that methods
refocus it with errors below 1e-4: on sim30 the best is 83 dB from brute force at a blur of 49 pixels, and 55 dB at 4
pixels."""
CONTRAST = 0.03
"""The product g of contrast and detail at edges in `cells_needed`. On sim30, with 18 to 36 cells and blurs of 17 to 49
pixels, `twigs` has 0.022 to 0.028, `lattice` 0.021 to 0.024, `leaves` 0.010 to 0.013."""
LEFT = 0.4
"""Share of the error that is left after the extrapolation from half as many cells. With 40 cells at a blur of 49
pixels, `twigs`, `leaves` and `wall` keep 0.52, 0.42 and 0.39 of it; with 24 cells at 21 pixels, 0.37, 0.76 and 0.41."""
FEWEST_CELLS = 6
"""Even number of cells below which nothing can be extrapolated: half as many are far too few."""
CELLS_OF_ONE_LAYER = 48
"""Number of cells along a side for a single layer that is only shifted; their sum is one filter and costs nothing."""
CELLS_OF_ONE_TRACED_LAYER = (5.5, 0.25)
"""Factor k and power a of the number of cells k B^a for a single layer whose rays are followed: it hides nothing, and
only its blur varies within a cell. With it, `floor` and `dome` of sim30 are 85 to 92 dB from 64 x 64 points."""
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


class CellCounts(NamedTuple):
    """Numbers of cells along the longer side of the aperture, of two pictures of a plane."""

    fine: int
    coarse: int | None  # of a second picture, from which both are extrapolated; None: there is none


def cells_needed(layers: Sequence[Layer], camera: Camera, slope: float, averaged: int = 1) -> CellCounts:
    """Number of cells that a plane needs, for an error within a bound.

    A cell blurs two layers apart from each other. Where an edge of the nearer one, of opacity a, moves by e1 h within a
    cell of h view steps and the farther one, of radiance L, by e2 h, the mean of a L differs from the product of the
    means by their covariance, (e1 h) (e2 h) / 12 grad a . grad L. It has any sign: over the B x B pixels of the blur
    that a pixel adds up, it averages out to 1/B. With h = B / (e n) and n cells along a side,

        error = (B / n)^2 / 12 x g / B = g B / (12 n^2),

    g for the contrast and the detail at the edges (`CONTRAST`). Of two pictures with n and n/2 cells, Richardson's
    extrapolation cancels terms in 1/n^2 and leaves a share of the error (`LEFT`).
    If one layer moves and all others are in focus, the blur of a cell is right however far that layer moves: B is the
    blur of the second fastest layer. On a disc the fastest decides, since cells do not follow its edge. A highlight may
    move over its surface by a part of its width within a cell. B counts pixels of the final picture, means over squares
    of `averaged` pixels of this one.
    """
    speeds, of_highlights = [], 1
    for layer in layers:
        speeds.append(max(abs(end - slope) for end in layer.surface.geometry.disparity_range(camera.size)))
        # A mirrored picture moves apart from the outline of its mirror.
        if layer.reflection and layer.reflection.share > 0:
            speeds.append(abs(layer.reflection.disparity - slope))
        if layer.highlight:
            steps = abs(layer.highlight.drift) / (HIGHLIGHT_STEP * layer.highlight.width)
            of_highlights = max(of_highlights, math.ceil(max(camera.grid) * steps - 1e-9))
    fastest = sorted(speeds)[-1 if camera.aperture == "disc" else -2 :]
    blur = max(camera.grid) * (fastest[0] if fastest else 0.0) / averaged
    if len(speeds) == 1:
        factor, power = CELLS_OF_ONE_TRACED_LAYER
        is_filtered = only_shifts(layers[0].surface)
        count = CELLS_OF_ONE_LAYER if is_filtered else max(of_highlights, math.ceil(factor * blur**power))
        return CellCounts(count, None)
    bound = camera.truth_error / (1 + blur / SMOOTH)
    half = math.ceil(math.sqrt(LEFT * CONTRAST * blur / (12 * bound)) / 2 - 1e-9)
    if half == 0:
        return CellCounts(of_highlights, None)
    half = max(half, FEWEST_CELLS // 2, of_highlights)
    return CellCounts(2 * half, half)


class CellFilter(NamedTuple):
    """Look-ups of a bitmap that faces the camera: blurred within a cell, and read at one position for each cell."""

    down: NDArray[np.float64]  # taps along a column
    across: NDArray[np.float64]  # taps along a row
    rows: NDArray[np.float64]  # row that pixel 0 reads through each row of cells, in samples of the window, [J]
    columns: NDArray[np.float64]  # column that pixel 0 reads through each column of cells, [I]


def box_taps(width: float, positions: NDArray) -> NDArray:
    """Taps of sum 1, symmetric and odd in number, that act as a box of some width in samples.

    Integrating the box over samples, and linear look-ups at `positions`, add a little blur. A kernel (-excess / 2,
    1 + excess, -excess / 2) removes its variance, so that all have that of the box, width^2 / 12.
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
            self._samples[bitmap] = bitmaps.refined(bitmap.window(self.camera.size, self.margin))
        samples = self._samples[bitmap]
        unused = (self.margin - margin) * FINE
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
    coarser: "FocalPlane | None" = None  # the same plane with fewer cells, for an extrapolation

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
        top, left = (-(length - 1) * FINE // 2 - self.margin * FINE for length in self.camera.size)
        return top, left

    def filter(self, disparity: float) -> CellFilter:
        """The filter of a bitmap that faces the camera."""
        e, cells = self.slope - disparity, self.cells
        rows, columns = (FINE * (self.margin + e * centres.numpy()) for centres in (cells.q, cells.p))
        speed = FINE * abs(e)
        return CellFilter(box_taps(speed * cells.height, rows), box_taps(speed * cells.width, columns), rows, columns)

    def crosses(self) -> NDArray[np.bool_]:
        """Pairs of layers that cross, [K, K]."""
        marks = np.zeros((len(self.layers),) * 2, np.bool_)
        for far, near in _crossing(self.layers, self.camera, self.slope):
            marks[far, near] = marks[near, far] = True
        return marks

    def copy_blur(self, layer: Layer) -> CopyBlur:
        """The blur of a slanted or curved layer."""
        n_steps = 256
        ends = [self.slope - end for end in disparity_span(self.camera, layer.surface.geometry, abs(self.slope))]
        # The table of a layer that is in focus everywhere must span more than 0, too.
        e = np.linspace(0, max(*map(abs, ends), 1e-6), n_steps)
        # A box of width w has the variance w^2 / 12. The linear look-ups through all cells add a part of it: t (1 - t)
        # at a fraction t of a sample. The copies add the rest.
        box = (e * self.cell_width * FINE) ** 2 / 12
        shares = [(FINE * e[:, None] * centres.numpy()) % 1 for centres in (self.cells.q, self.cells.p)]
        look_ups = sum((share * (1 - share)).mean(1) for share in shares) / 2
        nearest = 0.0 if min(ends) < 0 < max(ends) else min(map(abs, ends))
        return CopyBlur(bitmaps.levels(box - look_ups), (n_steps - 1) / float(e[-1]), nearest, self.slope)

    def read_box(self, layer: Layer, levels: range) -> tuple[int, int, int, int]:
        """Top, left, bottom and right, in samples, of what rays read of blurred copies of a layer, at least two."""
        near, far = disparity_span(self.camera, layer.surface.geometry, abs(self.slope))
        farthest = max(abs(self.slope - near), abs(self.slope - far))
        canvas, margin, ends = layer.bitmap.canvas, max(map(bitmaps.margin, levels)), []
        for start, n, size, side in (
            (canvas.top, canvas.height, self.camera.size[0], self.camera.grid[0]),
            (canvas.left, canvas.width, self.camera.size[1], self.camera.grid[1]),
        ):
            # A ray of pixel x through aperture column p meets the surface at x + (s - D) p.
            reach = math.ceil(FINE * ((size - 1) / 2 + farthest * side / 2)) + 1
            first, last = start * FINE // OVERSAMPLING - margin, (start + n) * FINE // OVERSAMPLING + margin
            ends.append((min(max(first, -reach), last - 2), max(min(last, reach + 1), first + 2)))
        (top, bottom), (left, right) = ends
        return top, left, bottom, right


def focal_planes(
    layers: Sequence[Layer], camera: Camera, slopes: Sequence[float], n_cells: int | None = None, averaged: int = 1
) -> list[FocalPlane]:
    """The planes of a stack, each with its visible layers and the cells that it needs, or `n_cells` along a side."""
    windows = Windows(camera, max(_margin(layers, camera, slope) for slope in slopes))
    planes = []
    for slope in slopes:
        visible = visible_layers(layers, slope, windows)
        counts = CellCounts(n_cells, None) if n_cells else cells_needed(visible, camera, slope, averaged)
        plane = FocalPlane(
            slope, camera, visible, cut_aperture(camera, counts.fine), _margin(visible, camera, slope), windows
        )
        if counts.coarse:
            plane = replace(plane, coarser=replace(plane, cells=cut_aperture(camera, counts.coarse)))
        planes.append(plane)
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
    """Layers that contribute to a plane: neither transparent nor behind an opaque layer in the part that it sees."""
    crossing = _crossing(layers, windows.camera, slope)
    visible: list[int] = []
    opaque: list[int] = []
    for k in reversed(range(len(layers))):
        if any((k, nearer) not in crossing for nearer in opaque):
            continue
        opacity = layers[k].bitmap.samples[3]
        if layers[k].surface.geometry.is_parallel:
            # Neither other layers nor a mirrored picture change how far rays meet this one.
            own_margin = _margin([replace(layers[k], reflection=None)], windows.camera, slope)
            opacity = windows.cut(layers[k].bitmap, own_margin)[3]
        # By NumPy: PyTorch's threads would wait for each other where several processes share the cores.
        values = opacity.numpy()
        if float(values.max()) > 0:
            visible.append(k)
        # Float32 products of opacities may miss 1 by some roundings.
        if float(values.min()) > 1 - 1e-6:
            opaque.append(k)
    return tuple(layers[k] for k in reversed(visible))
