"""The compiled loop that reads each view wherever a pixel of the picture asks for it, and takes the mean.

Letters: `v u` view row and column, `c` channel, `y x` row and column of the picture, `j i` of a view, `t` fraction of
a pixel, `k m` tap along a column and a row.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.errors import chosen
from lfref.functional import splines, threads
from lfref.functional.jit import compiled, inlined
from lfref.refocus import batches, lines
from lfref.refocus.sampling import (
    BLACK,
    BORDERS,
    FARTHEST,
    INTERPOLATIONS,
    LEFT_OUT,
    LINEAR,
    NEAREST,
    ON_VIEW,
    PERIODIC,
    Border,
    Interpolation,
    Tap,
)

# PART places
# Where each view shows what is at a pixel of the picture: the one thing that surfaces and homographies differ in.
#
# Letters: `u v` view column and row, `x y w` homogeneous pixel.

Positions = tuple[Tensor, Tensor, Tensor | bool]
"""x and y in a view, in pixels, and where the view can see the point at all, [H, W] each."""


class Places(NamedTuple):
    """At matrix (x, y, 1), then moved by slope times the view's offset from the middle of the grid."""

    matrices: Tensor | None = None
    """From pixels of the picture to those of each view, float64, [V, U, 3, 3]; None: the same pixel."""
    slopes: Tensor | None = None
    """At each pixel, in pixels per view step, float64, [H, W]; None: 0."""
    positions: Tensor | None = None
    """(v, u) of each view from the middle of the grid, in view steps, float64, CPU, [V, U, 2]; None: an even grid."""

    @property
    def tensors(self) -> list[Tensor]:
        """Those that are given and may be differentiated."""
        return [tensor for tensor in (self.matrices, self.slopes) if tensor is not None]

    def offsets(self, grid: tuple[int, int]) -> Tensor:
        """The positions, of an even grid (V, U) where none are given."""
        return lines.even(grid) if self.positions is None else self.positions

    def seen_from(self, v: int, u: int, offset: tuple[float, float], x: Tensor, y: Tensor) -> Positions:
        """Where a view shows pixels.

        Args:
            v: View row.
            u: View column.
            offset: Of that view from the middle of the grid, downwards and to the right, in view steps.
            x: Columns, float64, [1, W].
            y: Rows, float64, [H, 1].
        """
        visible: Tensor | bool = True
        if self.matrices is not None:
            x, y, w = (row[0] * x + row[1] * y + row[2] for row in self.matrices[v, u])
            visible = in_front = w > 0
            # Divided by 1 instead of 0 behind the camera: those are left out, but NaN would reach the gradients.
            w = torch.where(in_front, w, 1.0)
            x, y = x / w, y / w
        if self.slopes is not None:
            x, y = x + self.slopes * offset[1], y + self.slopes * offset[0]
        return x, y, visible


def pixels(views: Tensor) -> tuple[Tensor, Tensor]:
    """Columns x [1, W] and rows y [H, 1] of the picture, in pixels, float64.

    Args:
        views: Anything [..., H, W].
    """
    rows, columns = (torch.arange(n, dtype=torch.float64, device=views.device) for n in views.shape[-2:])
    return columns[None], rows[:, None]


# PART sampling
# Reading images at any position.
#
# Samples are gathered by index, so everything is differentiable twice, forwards too, also in the positions; each tap is
# a pixel and a weight.
# Letters: `x y` pixel column and row.


def sample(images: Tensor, x: Tensor, y: Tensor, way: Interpolation, border: Border) -> tuple[Tensor, Tensor]:
    """Read images at any position.

    Args:
        images: Floating point, [..., H, W].
        x: Columns to read at, in pixels, float64, [P...].
        y: Rows to read at, in pixels, float64, [P...].
        way: How they are read between samples, by a few of them.
        border: What is beyond them.

    Returns:
        Samples, [..., P...], and whether each position has one, [P...]: where it lies on the image if only samples
        count, else everywhere.
    """
    taps, has_sample = [], torch.ones_like(x, dtype=torch.bool)
    for position, length in zip((y, x), images.shape[-2:], strict=True):
        place = (position + 0.5).floor() if way.rounds else position
        taps.append([border.tap(*tap, length) for tap in _taps(place, way)])
        if border.counts_only_samples:
            has_sample = has_sample & (place >= -ON_VIEW) & (place <= length - 1 + ON_VIEW)
    return _tapped(images, *taps), has_sample


def _taps(position: Tensor, way: Interpolation) -> list[Tap]:
    """As `Interpolation.taps`."""
    assert way.weights is not None, "this interpolation reads all samples"
    position = position.clamp(-FARTHEST, FARTHEST)
    whole = position.detach().floor()
    return [(whole.long() - way.before + i, weight) for i, weight in enumerate(way.weights(position - whole))]


def _tapped(images: Tensor, rows: list[Tap], columns: list[Tap]) -> Tensor:
    flat, width = images.flatten(-2), images.shape[-1]
    # A weight of 0 must not let inf or NaN through; checked once, as the guard costs more than the taps themselves.
    keep = _as_they_are if bool(images.detach().sum().isfinite()) else _where_they_count
    total = torch.zeros((), dtype=images.dtype, device=images.device)
    for row, row_weight in rows:
        for column, column_weight in columns:
            weight = (row_weight * column_weight).to(images)
            total = total + keep(_gathered(flat, row * width + column), weight) * weight
    return total


def _gathered(flat: Tensor, index: Tensor) -> Tensor:
    """Samples of [..., K] at an index [P...] that all leading dimensions share; far faster than `flat[..., index]`."""
    batch = flat.shape[:-1]
    return flat.gather(-1, index.reshape(-1).expand(*batch, -1)).reshape(*batch, *index.shape)


def _as_they_are(samples: Tensor, weight: Tensor) -> Tensor:
    return samples


def _where_they_count(samples: Tensor, weight: Tensor) -> Tensor:
    # Finite samples stay: the derivative by the position needs them, at weight 0 too.
    return torch.where(weight == 0, samples.nan_to_num(0.0, 0.0, 0.0), samples)


# PART by_torch
# Means of views read at any position, by plain PyTorch operations: on any device, and differentiable.
#
# Letters: `u v` view column and row, `x y` pixel column and row.


def means_torch(
    views: Tensor, aperture: Tensor, planes: Sequence[Places], way: Interpolation, border: Border
) -> tuple[Tensor, Tensor]:
    """Means and coverages of all planes; as `mean_of_views`, but for names."""
    images, coverages = zip(*(_mean(views, aperture, places, way, border) for places in planes), strict=True)
    return torch.stack(images, dim=1), torch.stack(coverages)


def _mean(views: Tensor, aperture: Tensor, places: Places, way: Interpolation, border: Border) -> tuple[Tensor, Tensor]:
    """One plane, [B, C, H, W], and its coverage, [H, W]."""
    image = torch.zeros_like(batches.radiance(views[:, 0, 0]))
    coverage = torch.zeros(views.shape[-2:], dtype=torch.float64, device=views.device)
    offsets = places.offsets((aperture.shape[0], aperture.shape[1])).tolist()
    for v, u in aperture.nonzero().tolist():
        x, y, visible = places.seen_from(v, u, offsets[v][u], *pixels(views))
        samples, has_sample = sample(batches.radiance(views[:, v, u]), x, y, way, border)
        counted, weight = has_sample & visible, float(aperture[v, u])
        image = image + torch.where(counted, samples, 0.0) * weight
        coverage = coverage + counted.to(coverage) * weight
    return image * torch.where(coverage > 0, 1 / coverage, 0.0).to(image), coverage


MOST_TAPS = 4

Reals = NDArray[np.floating]
_cubic_weights = inlined(splines.weights)


class Rule(NamedTuple):
    """How views are read."""

    interpolation: int
    """Number of one of `INTERPOLATIONS`."""
    beyond: int
    """Number of one of `BORDERS`."""
    scale: float
    """Of their samples: 1 over the integer that is radiance 1."""


class Table(NamedTuple):
    """Where each view shows what is at a pixel (x, y): at matrix (x, y, 1), moved by slope times offset."""

    matrices: Reals
    """Homogeneous, float64, [V, U, 3, 3]."""
    slopes: Reals
    """At each pixel, in pixels per view step, float64, [H, W]."""
    offsets: Reals
    """(v, u) of each view from the middle, in view steps, float64, [V, U, 2]."""


@compiled
def mean(
    field: NDArray, weights: Reals, table: Table, rule: Rule, image: Reals, coverage: Reals, top: int, end: int
) -> None:
    """The mean of the views that have a sample, in the rows from `top` to before `end`.

    Args:
        field: Views, [V, U, C, H, W].
        weights: Of each view, of sum 1; those of weight 0 are not read, [V, U].
        table: Where they are read.
        rule: How they are read.
        image: Filled in these rows, 0 where no view has a sample, [C, H, W].
        coverage: Filled in these rows: weight of the views that have a sample, float64, [H, W].
        top: First row.
        end: One past the last row.
    """
    n_channels, width = image.shape[0], image.shape[2]
    total, covered = np.empty((n_channels, width)), np.empty(width)
    down, across = np.empty(MOST_TAPS), np.empty(MOST_TAPS)
    rows, columns = np.empty(MOST_TAPS, np.int64), np.empty(MOST_TAPS, np.int64)
    for y in range(top, end):
        total[:], covered[:] = 0, 0
        for v in range(field.shape[0]):
            for u in range(field.shape[1]):
                if weights[v, u] > 0:
                    _add_row(
                        field[v, u], weights[v, u], table, v, u, y, rule, total, covered, down, across, rows, columns
                    )
        for x in range(width):
            coverage[y, x] = covered[x]
            share = rule.scale / covered[x] if covered[x] > 0 else 0.0
            for c in range(n_channels):
                image[c, y, x] = share * total[c, x]


@compiled
def _add_row(
    view: NDArray,
    weight: float,
    table: Table,
    v: int,
    u: int,
    y: int,
    rule: Rule,
    total: Reals,
    covered: Reals,
    down: Reals,
    across: Reals,
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
) -> None:
    """Add a view to a row of the picture; the last four are room for taps."""
    n_channels, height, width = view.shape
    matrix, down_by, across_by = table.matrices[v, u], table.offsets[v, u, 0], table.offsets[v, u, 1]
    for x in range(covered.size):
        w = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
        if not w > 0:  # behind the camera
            continue
        slope = table.slopes[y, x]
        at_x = matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]
        at_y = matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]
        if w != 1:  # divisions take longer than all else
            at_x, at_y = at_x / w, at_y / w
        at_x, at_y = at_x + slope * across_by, at_y + slope * down_by
        at_x, at_y = _snapped(at_x, rule.interpolation), _snapped(at_y, rule.interpolation)
        if not (_counts(at_x, width, rule.beyond) and _counts(at_y, height, rule.beyond)):
            continue
        covered[x] += weight
        i, j = int(np.floor(at_x)), int(np.floor(at_y))
        if rule.interpolation == LINEAR and 0 <= i < width - 1 and 0 <= j < height - 1 and i < at_x and j < at_y:
            # Between four samples that all count.
            t_x, t_y = at_x - i, at_y - j
            for c in range(n_channels):
                upper = (1 - t_x) * view[c, j, i] + t_x * view[c, j, i + 1]
                lower = (1 - t_x) * view[c, j + 1, i] + t_x * view[c, j + 1, i + 1]
                total[c, x] += weight * ((1 - t_y) * upper + t_y * lower)
            continue
        n_taps = _set_taps(at_x, width, rule, columns, across)
        _set_taps(at_y, height, rule, rows, down)
        for c in range(n_channels):
            for k in range(n_taps):
                for m in range(n_taps):
                    share = down[k] * across[m]
                    # What does not count is not read: 0 times NaN is NaN.
                    if share != 0:
                        total[c, x] += weight * share * view[c, rows[k], columns[m]]


@inlined
def _snapped(position: float, interpolation: int) -> float:
    """The position that is really read; what is no number is read far away."""
    if not position >= -FARTHEST:
        return -FARTHEST
    position = min(position, FARTHEST)
    return np.floor(position + 0.5) if interpolation == NEAREST else position


@inlined
def _counts(position: float, length: int, beyond: int) -> bool:
    return beyond != LEFT_OUT or -ON_VIEW <= position <= length - 1 + ON_VIEW


@inlined
def _set_taps(position: float, length: int, rule: Rule, indices: NDArray[np.int64], weights: Reals) -> int:
    """Samples along an axis and their weights; returns how many."""
    whole = np.floor(position)
    t, first = position - whole, int(whole)
    if rule.interpolation == NEAREST:
        n_taps, weights[0] = 1, 1.0
    elif rule.interpolation == LINEAR:
        n_taps, weights[0], weights[1] = 2, 1 - t, t
    else:
        n_taps, first = 4, first - 1
        weights[0], weights[1], weights[2], weights[3] = _cubic_weights(t)
    for k in range(n_taps):
        index = first + k
        within = min(max(index, 0), length - 1)
        if rule.beyond == BLACK and within != index:
            weights[k] = 0.0
        indices[k] = index % length if rule.beyond == PERIODIC else within
    return n_taps


# PART by_numba
# Views read at any position on the CPU, at the machine's speed: what the compiled loop takes, and threads for it.

WORTH_A_THREAD = 1 << 16
"""Samples of a stack from which one more thread saves more than it costs."""


def means_numba(
    views: Tensor, aperture: Tensor, planes: Sequence[Places], way: Interpolation, border: Border
) -> tuple[Tensor, Tensor]:
    """Means and coverages of all planes, on the CPU; as `mean_of_views`, but for names that the loop knows."""
    assert way.number is not None, "the loop does not know this interpolation"
    assert border.number is not None, "the loop does not know this border"
    rule = Rule(way.number, border.number, 1 / batches.FULL_SCALE.get(views.dtype, 1))
    fields = (views if views.dtype in batches.FULL_SCALE else batches.radiance(views)).detach().numpy()
    height, width = views.shape[-2:]
    tables = [_table(places, views) for places in planes]
    weights = aperture.contiguous().numpy()
    working = np.float64 if views.dtype == torch.float64 else np.float32
    stack = np.empty((len(fields), len(tables), views.shape[3], height, width), working)
    coverage = np.empty((len(tables), height, width))
    n_threads = threads.worthwhile(stack.size, WORTH_A_THREAD)

    def work(b: int, n: int, band: tuple[int, int]) -> None:
        # All light fields write the same coverage.
        mean(fields[b], weights, tables[n], rule, stack[b, n], coverage[n], *band)

    jobs = itertools.product(range(len(fields)), range(len(tables)), threads.bands(height, n_threads))
    threads.share(work, jobs, n_threads)
    return torch.from_numpy(stack), torch.from_numpy(coverage)


def _table(places: Places, views: Tensor) -> Table:
    grid, size = batches.grid_and_size(views)
    still = torch.eye(3, dtype=torch.float64).expand(*grid, 3, 3)
    matrices = still if places.matrices is None else places.matrices
    slopes = torch.zeros(size, dtype=torch.float64) if places.slopes is None else places.slopes
    offsets = places.offsets(grid).contiguous().numpy()
    return Table(matrices.contiguous().numpy(), slopes.contiguous().numpy(), offsets)


# PART mean_of_views
# The mean over the aperture of views that are read wherever the places of a plane lie in them.


def mean_of_views(
    views: Tensor, aperture: Tensor, planes: Sequence[Places], interpolation: str, border: str
) -> tuple[Tensor, Tensor]:
    """Weighted mean, at each pixel, of the views that have a sample there; 0 where none has.

    Args:
        views: Light fields, floating point, uint8 or uint16, [B, V, U, C, H, W].
        aperture: Weights that sum to 1, float64, [V, U]; a view of weight 0 is not read.
        planes: Where the views are read for each plane.
        interpolation: A key of `INTERPOLATIONS` that reads a few samples only.
        border: A key of `BORDERS`.

    Returns:
        Stacks, float32 (float64 for such views), [B, N, C, H, W], and the share of the aperture that has a sample,
        float64, [N, H, W].

    Raises:
        InputError: An unknown border, or an interpolation that is unknown or reads all samples (`exact`).
    """
    local = {name: way for name, way in INTERPOLATIONS.items() if way.weights is not None}
    way = chosen("interpolation at positions that vary over the picture", interpolation, local)
    rule = chosen("border", border, BORDERS)
    compiler = batches.compiler_for(views, *(tensor for places in planes for tensor in places.tensors))
    if compiler == "numba" and way.number is not None and rule.number is not None:
        # Imported here: a compiler takes half a second to load, which a program that never refocuses need not spend.
        pass

        return means_numba(views, aperture, planes, way, rule)
    return means_torch(views, aperture, planes, way, rule)
