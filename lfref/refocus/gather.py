"""Means over the aperture of views that are read wherever a plane lies in them, for surfaces and homographies.

A pixel (x, y) of the picture is read at matrix (x, y, 1), then moved by slope times the view's offset. On the CPU a
compiled loop reads and adds; wherever derivatives are needed PyTorch gathers samples by index, so that everything is
differentiable twice, forwards too, also in the positions.
Letters: `v u` view row and column, `c` channel, `y x w` homogeneous pixel of the picture, `j i` row and column of a
view, `t` fraction of a pixel, `k m` tap along a column and a row.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.errors import chosen
from lfref.functional import loops, splines
from lfref.functional.loops import compiled, inlined
from lfref.refocus import batches
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
    Integers,
    Interpolation,
    Reals,
)  # fmt: skip

_cubic_weights = inlined(splines.weights)


class ViewMap(NamedTuple):
    """Positions in each view of what is at the pixels of one plane."""

    matrices: Tensor | None = None
    """From pixels of the picture to those of each view, float64, [V, U, 3, 3]; None: the same pixel."""
    slopes: Tensor | None = None
    """At each pixel, in pixels per view step, float64, [H, W]; None: 0."""
    positions: Tensor | None = None
    """(v, u) of each view from the middle of the grid, in view steps, float64, CPU, [V, U, 2]; None: an even grid."""


def mean_of_views(
    views: Tensor, aperture: Tensor, planes: Sequence[ViewMap], interpolation: str, border: str
) -> tuple[Tensor, Tensor]:
    """Weighted mean, at each pixel, of the views that have a sample there; 0 where none has.

    Args:
        views: Light fields, floating point, uint8 or uint16, [B, V, U, C, H, W].
        aperture: Weights of sum 1, float64, [V, U]; a view of weight 0 is not read.
        planes: Where the views are read for each plane.
        interpolation: A key of `INTERPOLATIONS` that reads a few samples only.
        border: A key of `BORDERS`.

    Returns:
        Stacks, float32 (float64 for such views), [B, N, C, H, W], and the share of the aperture that has a sample,
        float64, [N, H, W].

    Raises:
        InputError: An unknown border, or an interpolation that is unknown or reads all samples (`exact`).
    """
    local = {name: record for name, record in INTERPOLATIONS.items() if record.weights is not None}
    method = chosen("interpolation at positions that vary over the picture", interpolation, local)
    rule = chosen("border", border, BORDERS)
    tensors = [tensor for plane in planes for tensor in (plane.matrices, plane.slopes) if tensor is not None]
    if batches.compiler_for(views, *tensors) == "numba" and method.number is not None and rule.number is not None:
        return means_numba(views, aperture, planes, method.number, rule.number)
    return means_torch(views, aperture, planes, method, rule)


def means_torch(
    views: Tensor, aperture: Tensor, planes: Sequence[ViewMap], method: Interpolation, rule: Border
) -> tuple[Tensor, Tensor]:
    """Means and coverages of all planes, as `mean_of_views`."""
    n_rows, n_columns, height, width = *aperture.shape, *views.shape[-2:]
    rows, columns = (torch.arange(n, dtype=torch.float64, device=views.device) for n in (height, width))
    images, coverages = [], []
    for plane in planes:
        image = torch.zeros_like(batches.radiance(views[:, 0, 0]))
        coverage = torch.zeros(height, width, dtype=torch.float64, device=views.device)
        offsets = (batches.even((n_rows, n_columns)) if plane.positions is None else plane.positions).tolist()
        for v, u in aperture.nonzero().tolist():
            x, y, visible = columns[None], rows[:, None], torch.ones_like(coverage, dtype=torch.bool)
            if plane.matrices is not None:
                x, y, w = (row[0] * x + row[1] * y + row[2] for row in plane.matrices[v, u])
                visible = w > 0
                # Divided by 1 instead of 0 behind the camera: those are left out, but NaN would reach the gradients.
                w = torch.where(visible, w, 1.0)
                x, y = x / w, y / w
            if plane.slopes is not None:
                x, y = x + plane.slopes * offsets[v][u][1], y + plane.slopes * offsets[v][u][0]
            samples, has_sample = sample(batches.radiance(views[:, v, u]), x, y, method, rule)
            counted, weight = has_sample & visible, float(aperture[v, u])
            image = image + torch.where(counted, samples, 0.0) * weight
            coverage = coverage + counted.to(coverage) * weight
        images.append(image * torch.where(coverage > 0, 1 / coverage, 0.0).to(image))
        coverages.append(coverage)
    return torch.stack(images, dim=1), torch.stack(coverages)


def sample(images: Tensor, x: Tensor, y: Tensor, method: Interpolation, border: Border) -> tuple[Tensor, Tensor]:
    """Read images [..., H, W] at any positions in pixels, float64, that broadcast to [P...].

    Returns:
        Samples, [..., P...], and whether each position has one, [P...]: where it lies on the image if only samples
        count, else everywhere.
    """
    assert method.weights is not None, "this interpolation reads all samples"
    taps, has_sample = [], torch.ones_like(x, dtype=torch.bool)
    for exact, length in zip((y, x), images.shape[-2:], strict=True):
        position = (exact + 0.5).floor() if method.rounds else exact
        within = position.clamp(-FARTHEST, FARTHEST)
        whole = within.detach().floor()
        weights = enumerate(method.weights(within - whole))
        taps.append([border.tap(whole.long() - method.before + i, weight, length) for i, weight in weights])
        if border.counts_only_samples:
            has_sample = has_sample & (position >= -ON_VIEW) & (position <= length - 1 + ON_VIEW)
    flat, width = images.flatten(-2), images.shape[-1]
    # A weight of 0 must not let inf or NaN through; checked once, as the guard costs more than the taps themselves.
    is_finite = bool(images.detach().sum().isfinite())
    total = torch.zeros((), dtype=images.dtype, device=images.device)
    for row, row_weight in taps[0]:
        for column, column_weight in taps[1]:
            weight, index = (row_weight * column_weight).to(images), row * width + column
            # Far faster than `flat[..., index]`.
            samples = flat.gather(-1, index.reshape(-1).expand(*flat.shape[:-1], -1))
            samples = samples.reshape(*flat.shape[:-1], *index.shape)
            if not is_finite:
                # Finite samples stay: the derivative by the position needs them, at weight 0 too.
                samples = torch.where(weight == 0, samples.nan_to_num(0.0, 0.0, 0.0), samples)
            total = total + samples * weight
    return total, has_sample


class Table(NamedTuple):
    """A `ViewMap` and the way of reading, as the compiled loop takes them."""

    matrices: Reals
    """Homogeneous, float64, [V, U, 3, 3]."""
    slopes: Reals
    """At each pixel, in pixels per view step, float64, [H, W]."""
    offsets: Reals
    """(v, u) of each view from the middle, in view steps, float64, [V, U, 2]."""
    interpolation: int
    """Number of one of `INTERPOLATIONS`."""
    border: int
    """Number of one of `BORDERS`."""
    scale: float
    """Of the samples: 1 over the integer that is radiance 1."""


def means_numba(
    views: Tensor, aperture: Tensor, planes: Sequence[ViewMap], interpolation: int, border: int
) -> tuple[Tensor, Tensor]:
    """Means and coverages of all planes on the CPU, as `mean_of_views`, by the numbers of the records."""
    scale = 1 / batches.FULL_SCALE.get(views.dtype, 1)
    fields = (views if views.dtype in batches.FULL_SCALE else batches.radiance(views)).detach().numpy()
    (grid, size), weights = batches.grid_and_size(views), aperture.contiguous().numpy()
    still, no_slopes = torch.eye(3, dtype=torch.float64).expand(*grid, 3, 3), torch.zeros(size, dtype=torch.float64)
    tables = []
    for plane in planes:
        matrices = still if plane.matrices is None else plane.matrices
        slopes = no_slopes if plane.slopes is None else plane.slopes
        offsets = batches.even(grid) if plane.positions is None else plane.positions
        arrays = [tensor.contiguous().numpy() for tensor in (matrices, slopes, offsets)]
        tables.append(Table(arrays[0], arrays[1], arrays[2], interpolation, border, scale))
    working = np.float64 if views.dtype == torch.float64 else np.float32
    stack = np.empty((len(fields), len(tables), views.shape[3], *size), working)
    coverage = np.empty((len(tables), *size))
    n_threads = loops.worthwhile(stack.size, 1 << 16)  # samples from which one more thread pays

    def work(b: int, n: int, band: tuple[int, int]) -> None:
        # All light fields write the same coverage.
        _mean_rows(fields[b], weights, tables[n], stack[b, n], coverage[n], *band)

    jobs = itertools.product(range(len(fields)), range(len(tables)), loops.bands(size[0], n_threads))
    loops.share(work, jobs, n_threads)
    return torch.from_numpy(stack), torch.from_numpy(coverage)


@compiled
def _mean_rows(field: NDArray, weights: Reals, table: Table, image: Reals, coverage: Reals, top: int, end: int) -> None:
    """Fill the rows from `top` to before `end` of the mean [C, H, W] and the coverage [H, W] of a light field."""
    n_channels, width = image.shape[0], image.shape[2]
    total, covered = np.empty((n_channels, width)), np.empty(width)
    # Room for the weights and indices of at most 4 taps along a column and along a row.
    down, across, rows, columns = np.empty(4), np.empty(4), np.empty(4, np.int64), np.empty(4, np.int64)
    for y in range(top, end):
        total[:], covered[:] = 0, 0
        for v in range(field.shape[0]):
            for u in range(field.shape[1]):
                if weights[v, u] > 0:
                    _add_row(field[v, u], weights[v, u], table, v, u, y, total, covered, down, across, rows, columns)
        for x in range(width):
            coverage[y, x] = covered[x]
            share = table.scale / covered[x] if covered[x] > 0 else 0.0
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
    total: Reals,
    covered: Reals,
    down: Reals,
    across: Reals,
    rows: Integers,
    columns: Integers,
) -> None:
    """Add a view to row y of the picture."""
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
        at_x = _snapped(at_x + slope * across_by, table.interpolation)
        at_y = _snapped(at_y + slope * down_by, table.interpolation)
        if not (_counts(at_x, width, table.border) and _counts(at_y, height, table.border)):
            continue
        covered[x] += weight
        i, j = int(np.floor(at_x)), int(np.floor(at_y))
        if table.interpolation == LINEAR and 0 <= i < width - 1 and 0 <= j < height - 1 and i < at_x and j < at_y:
            # The common case, between four samples that all count, without tables of taps.
            t_x, t_y = at_x - i, at_y - j
            for c in range(n_channels):
                upper = (1 - t_x) * view[c, j, i] + t_x * view[c, j, i + 1]
                lower = (1 - t_x) * view[c, j + 1, i] + t_x * view[c, j + 1, i + 1]
                total[c, x] += weight * ((1 - t_y) * upper + t_y * lower)
            continue
        n_taps = _set_taps(at_x, width, table, columns, across)
        _set_taps(at_y, height, table, rows, down)
        for c in range(n_channels):
            for k in range(n_taps):
                for m in range(n_taps):
                    share = down[k] * across[m]
                    # What does not count is not read: 0 times NaN is NaN.
                    if share != 0:
                        total[c, x] += weight * share * view[c, rows[k], columns[m]]


@inlined
def _snapped(position: float, interpolation: int) -> float:
    """The position that is read; what is no number is read far away."""
    if not position >= -FARTHEST:
        return -FARTHEST
    position = min(position, FARTHEST)
    return np.floor(position + 0.5) if interpolation == NEAREST else position


@inlined
def _counts(position: float, length: int, border: int) -> bool:
    return border != LEFT_OUT or -ON_VIEW <= position <= length - 1 + ON_VIEW


@inlined
def _set_taps(position: float, length: int, table: Table, indices: Integers, weights: Reals) -> int:
    """Set samples along an axis and their weights, as `Interpolation.taps` and `Border.tap`; returns how many."""
    whole = np.floor(position)
    t, first = position - whole, int(whole)
    if table.interpolation == NEAREST:
        n_taps, weights[0] = 1, 1.0
    elif table.interpolation == LINEAR:
        n_taps, weights[0], weights[1] = 2, 1 - t, t
    else:
        n_taps, first = 4, first - 1
        weights[0], weights[1], weights[2], weights[3] = _cubic_weights(t)
    for k in range(n_taps):
        index = first + k
        within = min(max(index, 0), length - 1)
        if table.border == BLACK and within != index:
            weights[k] = 0.0
        indices[k] = index % length if table.border == PERIODIC else within
    return n_taps
