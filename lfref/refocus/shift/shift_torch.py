"""Shift-and-sum by plain PyTorch operations: on any device, differentiable, and what compiled loops must equal.

Letters: `v u` view row and column.
"""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.errors import chosen
from lfref.functional import fourier
from lfref.geometry import Slopes
from lfref.refocus import batches, lines, sampling
from lfref.refocus import footprint_blur as boxes
from lfref.refocus.sampling import BORDERS, INTERPOLATIONS, Border, Interpolation

# PART task
# What shift-and-sum has to do, whoever does it: PyTorch, or loops compiled for the CPU or a GPU (`by_...`).
#
# Letters: `v u` view row and column, `s` slope in pixels per view step.


class Shifts(NamedTuple):
    """How far one plane shifts the views, and how widely it then blurs their sum, in pixels."""

    rows: tuple[float, ...]
    """Vertical shift of each view row, [V]."""
    columns: tuple[tuple[float, ...], ...]
    """Horizontal shift of each view of a row, [V, U]; [1, U] if that of all rows is the same."""
    width: float = 0.0
    """Of the box that a view's cell covers; 0: a point."""

    def along_row(self, v: int) -> tuple[float, ...]:
        """Horizontal shift of each view of row v, [U]."""
        return self.columns[v if len(self.columns) > 1 else 0]


class Task(NamedTuple):
    """Planes to be summed, apart from the views themselves."""

    planes: tuple[Shifts, ...]
    """[N]."""
    aperture: tuple[tuple[float, ...], ...]
    """Weight of each view, together 1, [V, U]: the rows that it says, whatever those of the grid."""
    size: tuple[int, int]
    """Height and width of a view in pixels."""
    interpolation: Interpolation
    """How a view is read between its samples."""
    border: Border
    """How a view continues beyond its edge."""

    @property
    def blurs(self) -> bool:
        """Whether any plane is seen through cells instead of points."""
        return any(shifts.width > 0 for shifts in self.planes)

    @property
    def is_separable(self) -> bool:
        """Whether all rows of views stand at the same columns."""
        return all(len(shifts.columns) == 1 for shifts in self.planes)

    @property
    def reach(self) -> int:
        """Samples beyond the edge that may be read."""
        taken = (shift for shifts in self.planes for shift in itertools.chain(shifts.rows, *shifts.columns))
        return math.ceil(max(map(abs, taken))) + 1

    def span(self, shift: float, axis: int) -> tuple[int, int]:
        """First and one-past-last output sample that a view shifted along an axis of [H, W] counts for."""
        length = self.size[axis]
        return sampling.sampled_span(shift, length) if self.border.counts_only_samples else (0, length)

    def beyond(self, axis: int) -> Tensor:
        """Sample that stands at each place from -reach to length + reach along an axis; -1: black, int64, CPU."""
        numbered = torch.arange(1, self.size[axis] + 1, dtype=torch.float64)
        return self.border.extend(numbered[None], self.reach, -1)[0].long() - 1

    def coverage(self, shifts: Shifts) -> Tensor:
        """Share of the aperture that has a sample at each pixel of a plane, float64, CPU, [H, W]."""
        rows, columns = self.sampled(shifts)
        aperture = torch.tensor(self.aperture, dtype=torch.float64)
        if len(columns) == 1:
            return torch.einsum("vy,vu,ux->yx", rows, aperture, columns[0])
        return rows.T @ torch.einsum("vu,vux->vx", aperture, columns)

    @property
    def coverages(self) -> Tensor:
        """The same of all planes, [N, H, W]."""
        return torch.stack([self.coverage(shifts) for shifts in self.planes])

    def sampled(self, shifts: Shifts) -> tuple[Tensor, Tensor]:
        """Where view rows, and views of each row, have a sample: 1 or 0, float64, CPU, [V, H] and [V or 1, U, W]."""
        columns = [sampling.sampled(list(row), self.size[1]) for row in shifts.columns]
        return sampling.sampled(list(shifts.rows), self.size[0]), torch.stack(columns)

    def factors(self, shifts: Shifts) -> Tensor:
        """What a plane's sum, blurred, is multiplied by: 1 over the coverage, as blurred, if only samples count."""
        if not self.border.counts_only_samples:
            return torch.ones(self.size, dtype=torch.float64)
        covered = self.coverage(shifts)
        return boxes.inverse(covered, boxes.boxed(covered, shifts.width, self.border))


def plan(
    slopes: Slopes,
    grid: tuple[int, int],
    size: tuple[int, int],
    interpolation: str = "linear",
    border: str = "renormalize",
    weights: Tensor | None = None,
    widths: Sequence[float] | None = None,
    positions: Tensor | None = None,
) -> Task:
    """The task of refocusing at some slopes.

    Args:
        slopes: Focus in pixels per view step, [N].
        grid: Number of view rows and columns (V, U).
        size: Height and width (H, W) of a view in pixels.
        interpolation: A key of `INTERPOLATIONS`.
        border: A key of `BORDERS`.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.
        widths: Of the box that each plane is blurred by, in pixels, >= 0, [N]; None blurs none.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Raises:
        InputError: Slopes, weights, positions or names that cannot be used.
    """
    method, cameras = chosen("interpolation", interpolation, INTERPOLATIONS), lines.lines(grid, positions)
    planes = lines.checked_slopes(slopes, grid, size, positions).tolist()
    offsets = [cameras.rows.tolist(), *cameras.columns.tolist()]

    def shifts(slope: float, width: float) -> Shifts:
        rows, *columns = (tuple(method.snap(slope * offset) for offset in line) for line in offsets)
        return Shifts(rows, tuple(columns), width)

    return Task(
        tuple(map(shifts, planes, widths or [0.0] * len(planes))),
        tuple(map(tuple, batches.checked_weights(weights, grid).reshape(cameras.shape).tolist())),
        size,
        method,
        chosen("border", border, BORDERS),
    )


# PART shifting
# Whole views shifted by fractions of a pixel along one axis: by a few taps, or in the Fourier domain.
#
# A view is read at x + shift, and added onto a running sum, so that nothing is stored twice.

SEAM = 16  # samples over which a view that is not periodic is faded into its other end before a Fourier shift


def extended(views: Tensor, task: Task, axis: int) -> tuple[Tensor, int]:
    """The views with what lies beyond their edges, as far as the task's shifts read.

    Args:
        views: Images [..., H, W].
        task: How they are read.
        axis: -1 (columns) or -2 (rows).

    Returns:
        The extended views, and how many samples were put before them.
    """
    if task.interpolation.weights is not None:
        return task.border.extend(views, task.reach, axis), task.reach
    if task.border.is_periodic:
        return views, 0
    pad = task.reach + SEAM
    return _faded(task.border.extend(views, pad, axis).movedim(axis, -1)).movedim(-1, axis), pad


def add(total: Tensor, extended: Tensor, pad: int, shift: float, task: Task, axis: int) -> None:
    """Add a shifted view, cut back to the samples that count, onto a running sum.

    Args:
        total: Added to in place, [..., H, W].
        extended: The view with `pad` more samples before it, as `extended` makes it.
        pad: As `extended` says.
        shift: In samples.
        task: How it is read.
        axis: -1 (columns) or -2 (rows).
    """
    start, stop = task.span(shift, axis)
    part = total.narrow(axis, start, stop - start)
    if task.interpolation.weights is None:
        part.add_(_shifted(extended, shift, axis).narrow(axis, pad + start, stop - start))
        return
    for offset, weight in task.interpolation.taps(shift):
        # A weight of 0 must not touch its sample: at whole shifts it need not exist, and 0 * inf is NaN.
        if weight != 0:
            part.add_(extended.narrow(axis, pad + offset + start, stop - start), alpha=weight)


def _faded(extended: Tensor) -> Tensor:
    """Both ends of rows faded into each other: where the transform starts over, a jump would ring across the view."""
    extended = extended.clone()
    fade = 0.5 - 0.5 * torch.cos(torch.linspace(0, torch.pi, 2 * SEAM + 2, dtype=torch.float64))[1:-1]
    before, after = extended[..., -SEAM - 1 :][..., :1], extended[..., SEAM : SEAM + 1]
    seam = before + (after - before) * fade.to(extended)
    extended[..., -SEAM:], extended[..., :SEAM] = seam[..., :SEAM], seam[..., SEAM:]
    return extended


def _shifted(views: Tensor, shift: float, axis: int) -> Tensor:
    """Periodic views read at x + shift by trigonometric interpolation."""
    length = views.shape[axis]
    phases = fourier.shift_phases(fourier.half_frequencies(length), torch.tensor(shift, dtype=torch.float64))
    phases = phases.to(views.device, fourier.complex_dtype(views.dtype))
    spectrum = torch.fft.rfft(views, dim=axis) * (phases if axis == -1 else phases[:, None])
    return torch.fft.irfft(spectrum, n=length, dim=axis)


def shift_and_sum(views: Tensor, task: Task) -> Tensor:
    """The sums of the shifted views, over the weight of those that count.

    Args:
        views: Light fields, [B, V, U, C, H, W].
        task: What is to be summed.

    Returns:
        Stacks, float32 (float64 for such views), [B, N, C, H, W].
    """
    images = [torch.zeros_like(batches.radiance(views[:, 0, 0])) for _ in task.planes]
    aperture = torch.tensor(task.aperture, dtype=images[0].dtype, device=views.device)
    for v, (view_row, weights) in enumerate(zip(views.unbind(1), aperture, strict=True)):
        # One view row at a time: only it is held as floating point, extended beyond its edges.
        row, pad = extended(batches.radiance(view_row) * weights[:, None, None, None], task, -1)
        for image, shifts in zip(images, task.planes, strict=True):
            row_sum = torch.zeros_like(image)
            for view, shift in zip(row.unbind(1), shifts.along_row(v), strict=True):
                add(row_sum, view, pad, shift, task, -1)
            beyond, pad_rows = extended(row_sum, task, -2)
            add(image, beyond, pad_rows, shifts.rows[v], task, -2)
    return torch.stack([finished(*each, task) for each in zip(images, task.planes, strict=True)], dim=1)


def finished(total: Tensor, shifts: Shifts, task: Task) -> Tensor:
    """A plane's sum as seen through the views' cells, over the weight of the samples that count; may be overwritten.

    Args:
        total: [..., H, W].
        shifts: Of the plane.
        task: What is to be summed.
    """
    image = boxes.boxed(total, shifts.width, task.border)
    return image.mul_(task.factors(shifts).to(image)) if task.border.counts_only_samples else image
