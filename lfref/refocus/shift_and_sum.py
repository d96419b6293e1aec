"""Shift-and-sum refocusing: the mean over the aperture of views shifted in proportion to their position.

`I_s(x, y) = sum_uv w_uv L[v, u](x + s (u - u0), y + s (v - v0)) / sum_uv w_uv`, over views that have a sample there.
The shift is separable, so each plane takes a horizontal pass over every view row and one vertical pass.
Letters: `u v` view column and row, `x y` pixel column and row, `s` slope in pixels per view step.
Source: Ng et al., "Light Field Photography with a Hand-held Plenoptic Camera", 2005, section 4.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import chosen
from lfref.geometry import Slopes
from lfref.refocus import batches, borders
from lfref.refocus.borders import BORDERS, Border
from lfref.refocus.interpolation import INTERPOLATIONS, Interpolation


def shift_and_sum(
    views: Tensor,
    slopes: Slopes,
    interpolation: str = "linear",
    border: str = "renormalize",
    weights: Tensor | None = None,
) -> Tensor:
    """Refocus light fields at the given slopes.

    Args:
        views: Radiance, usually in [0, 1], floating point, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        interpolation: `nearest`, `linear`, `cubic` or `exact` (Fourier shift).
        border: `renormalize` (only views with a sample there count), `edge`, `zero` or `wrap`.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.

    Returns:
        Stacks in the order of the slopes, type and device of the views, [..., N, C, H, W]. A pixel that no weighted
        view covers (see `coverage`) is 0.

    Raises:
        InputError: Views, slopes, weights or names that cannot be used.
    """
    return batches.over_batches(views, lambda batch: _stack(batch, slopes, interpolation, border, weights))


def coverage(
    slopes: Slopes,
    grid: tuple[int, int],
    size: tuple[int, int],
    interpolation: str = "linear",
    weights: Tensor | None = None,
) -> Tensor:
    """Share of the aperture that has a sample at each pixel of each plane.

    Args:
        slopes: Focus in pixels per view step, [N].
        grid: Number of view rows and columns (V, U).
        size: Height and width (H, W) of a view in pixels.
        interpolation: As in `shift_and_sum`.
        weights: As in `shift_and_sum`.

    Returns:
        Coverage in [0, 1], float64, CPU, [N, H, W].

    Raises:
        InputError: Slopes, weights or names that cannot be used.
    """
    aperture = batches.checked_weights(weights, grid)
    snap = chosen("interpolation", interpolation, INTERPOLATIONS).snap
    planes = geometry.checked_slopes(slopes, grid, size).tolist()
    return torch.stack([_coverage(_shifts(slope, grid, snap), aperture, size) for slope in planes])


@dataclass(frozen=True)
class _Pass:
    """How views are shifted and summed along either axis."""

    interpolation: Interpolation
    border: Border
    reach: int
    """Samples that the largest shift reaches beyond the edge."""

    def extended(self, view: Tensor, axis: int) -> tuple[Tensor, int]:
        """The view with what lies beyond its edge, and how many samples were put before it."""
        return self.interpolation.extend(view, self.border, self.reach, axis)

    def summed(self, extended: list[Tensor], shifts: list[float], pad: int, axis: int) -> Tensor:
        """The shifted views added up, cut back to their own size."""
        length = extended[0].shape[axis] - 2 * pad
        total = torch.zeros_like(extended[0].narrow(axis, 0, length))
        for view, shift in zip(extended, shifts, strict=True):
            span = borders.sampled_span(shift, length) if self.border.counts_only_samples else (0, length)
            self.interpolation.add_shifted(total, view, shift, pad, span, axis)
        return total


def _shifts(slope: float, grid: tuple[int, int], snap: Callable[[float], float]) -> tuple[list[float], list[float]]:
    """Vertical and horizontal shift of each view row and column."""
    rows, columns = ((slope * geometry.angular_offsets(n)).tolist() for n in grid)
    return [snap(shift) for shift in rows], [snap(shift) for shift in columns]


def _coverage(shifts: tuple[list[float], list[float]], aperture: Tensor, size: tuple[int, int]) -> Tensor:
    rows, columns = (borders.sampled(shift, length) for shift, length in zip(shifts, size, strict=True))
    return torch.einsum("vy,vu,ux->yx", rows, aperture, columns)


def _stack(views: Tensor, slopes: Slopes, interpolation: str, border: str, weights: Tensor | None) -> Tensor:
    grid, size = (views.shape[1], views.shape[2]), (views.shape[-2], views.shape[-1])
    planes = geometry.checked_slopes(slopes, grid, size)
    aperture = batches.checked_weights(weights, grid)
    weighted = views if weights is None else views * aperture.to(views)[:, :, None, None, None]
    scale = 1 / (grid[0] * grid[1]) if weights is None else 1.0
    steps = _Pass(
        chosen("interpolation", interpolation, INTERPOLATIONS),
        chosen("border", border, BORDERS),
        math.ceil(geometry.corner_shift(planes, grid)) + 1,
    )
    extended, pad = steps.extended(weighted, -1)
    images = []
    for slope in planes.tolist():
        shifts = _shifts(slope, grid, steps.interpolation.snap)
        image = _plane(extended, pad, shifts, steps) * scale
        if steps.border.counts_only_samples:
            covered = _coverage(shifts, aperture, size)
            image = image * torch.where(covered > 0, 1 / covered, 0.0).to(image)
        images.append(image)
    return torch.stack(images, dim=1)


def _plane(extended: Tensor, pad: int, shifts: tuple[list[float], list[float]], steps: _Pass) -> Tensor:
    """One refocused plane, not yet divided by its weights, [B, C, H, W]."""
    # One view row at a time, so that its running sum stays in the cache.
    rows = [steps.summed(list(row.unbind(1)), shifts[1], pad, -1) for row in extended.unbind(1)]
    vertical = [steps.extended(row, -2) for row in rows]
    return steps.summed([row for row, _ in vertical], shifts[0], vertical[0][1], -2)
