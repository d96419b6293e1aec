"""Refocusing through an aperture with an area, each layer of the scene blurred by its own distance from the focus.

Each view stands for a cell of the aperture, within which light at disparity d moves by |s - d| pixels: the sum over the
views, a sum of points, lacks the factor `c(s - d)` of the cell (see `aperture_response`). Layers tell how much of each
frequency is at which disparity; what they do not explain is taken to be at the middle one, m:
`I^_s = c(s - m) E_s + sum_d (c(s - d) - c(s - m)) D(s - d) f_d^`, E exact refocusing and f the layers.
So layers only correct what the cells do: without area (`fill` 0) this is exact refocusing, whatever they are.
Letters: `N` planes, `K` layers, `s` slope, `d` disparity in pixels per view step; others as in `disparity_layers`.
"""

import torch
from torch import Tensor

from lfref import geometry
from lfref.geometry import Slopes
from lfref.refocus import batches
from lfref.refocus.fourier import aperture_response, disparity_layers, frames, mixing
from lfref.refocus.fourier.disparity_layers import RIDGE
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.layer_energies import Energies


def refocus_by_layers(
    views: Tensor,
    slopes: Slopes,
    disparities: Slopes | None = None,
    n_layers: int = 12,
    ridge: float = RIDGE,
    fill: float = 1.0,
    weights: Tensor | None = None,
    border: str = "edge",
) -> Tensor:
    """Refocus light fields as a lens with the whole aperture would, by Fourier disparity layers.

    Linear in the views where the disparities are given; where they are found, derivatives leave that out.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        disparities: Of the layers, in pixels per view step, [K]; None finds them for each light field.
        n_layers: How many, where disparities are to be found, >= 1.
        ridge: As in `disparity_layers`, above 0.
        fill: Width of the cell that a view stands for, in view steps, >= 0; 1 leaves no gaps, 0 sums points.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.
        border: `edge`: beyond the border the outermost pixel goes on; `wrap`: the opposite border follows.

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views, [..., N, C, H, W].

    Raises:
        InputError: An argument that cannot be used.

    Example:
        >>> views = torch.rand(5, 5, 3, 48, 64)
        >>> lfref.refocus_by_layers(views, [-0.5, 0.5]).shape
        torch.Size([2, 3, 48, 64])
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    planes, aperture = geometry.checked_slopes(slopes, grid, size), batches.checked_weights(weights, grid)
    width = aperture_response.checked_fill(fill)
    stacks = []
    for field in batch:  # each has layers of its own
        radiance = batches.radiance(field)
        energies = disparity_layers.expected(radiance, disparities, n_layers, aperture)
        stacks.append(by_energies(radiance, planes, energies, aperture, ridge, width, border))
    return batches.restored(torch.stack(stacks), views)


def by_energies(
    field: Tensor,
    planes: Tensor,
    energies: Energies,
    aperture: Tensor,
    ridge: float = RIDGE,
    fill: float = 1.0,
    border: str = "edge",
) -> Tensor:
    """One light field refocused by layers whose energies are known; arguments as for `refocus_by_layers`.

    Args:
        field: Float32 or float64, [V, U, C, H, W].
        planes: Slopes, float64, [N].
        energies: Of the layers.
        aperture: Weight of each view, together 1, [V, U].
        ridge: Above 0.
        fill: In view steps.
        border: `edge` or `wrap`.

    Returns:
        Stack, [N, C, H, W].
    """
    grid, size = batches.grid_and_size(field)
    frame = frames.framed(border, size, geometry.corner_shift(torch.cat([planes, energies.disparities]), grid))
    return frame.pictures(_refocused(frame.extended(field), planes, energies, aperture, ridge, fill))


def _refocused(
    field: Tensor, planes: Tensor, energies: Energies, aperture: Tensor, ridge: float, fill: float
) -> Tensor:
    """Spectra of the planes, [N, C, h, w // 2 + 1], of periodic views, [V, U, C, h, w]."""
    period = batches.grid_and_size(field)[1]
    exact = torch.fft.rfft2(exact_fourier(field, torch.cat([planes, energies.disparities]), aperture))
    at_planes, at_layers = exact[None].split([len(planes), len(energies.disparities)], dim=1)
    layers = disparity_layers.fitted(at_layers, energies, aperture, period, ridge)
    distances = planes[:, None] - energies.disparities
    from_middle = (planes - energies.disparities @ energies.shares)[:, None]
    of_middle = aperture_response.of_cell(from_middle.expand_as(distances), fill, period)
    of_layers = aperture_response.of_cell(distances, fill, period)
    correction = aperture_response.of_points(distances, aperture, period).times(of_layers.minus(of_middle))
    cell = of_middle.rows[:, :1, 0, :, None] * of_middle.columns[:, :1, 0, None]
    return (cell.to(field) * at_planes + mixing.multiplied(layers, correction))[0]
