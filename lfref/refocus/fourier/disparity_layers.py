"""Fourier disparity layers: views as a sum of shifted layers, from which any photograph of the scene can be made.

`L^[v, u](k) = sum_d f_d^(k) exp(-2 pi i d ((u - u0) kx + (v - v0) ky))`, the f_d by one ridge regression a frequency:
`(G + ridge / p) f = B`, where `B_d` is exact refocusing at disparity d, `G_de = D(d - e)` the response of the aperture
(see `aperture_response`) and p the share of the light that each layer is expected to hold.
What layers cannot explain (occlusion, gloss, reflections, disparities between theirs) is lost in pictures made of them
alone; `layered_refocusing` keeps it.
Letters: `u v` view column and row, `K` layers, `kx ky` frequency in cycles per pixel, `d e` disparities, `s` slope.
Source: Le Pendu, Guillemot, Smolic, "A Fourier Disparity Layer Representation for Light Fields", 2019.
"""

import dataclasses
import math

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.functional import fourier
from lfref.geometry import Slopes
from lfref.refocus import batches
from lfref.refocus.fourier import layer_energies, layer_mixing
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.layer_energies import Energies
from lfref.refocus.fourier.layer_mixing import Frame

RIDGE = 1e-3
ROUNDING = 100  # epsilons: what a smaller ridge would have to hold down is rounding


@dataclasses.dataclass(frozen=True, eq=False)
class Layers:
    """A light field as layers, each at one disparity."""

    spectra: Tensor
    """Of the layers as the central viewpoint sees them, complex, [..., K, C, h, w // 2 + 1]."""
    energies: Energies
    """Their disparities, and the shares of the light that they were expected to hold."""
    grid: tuple[int, int]
    """Number of view rows and columns (V, U)."""
    frame: Frame
    """Where the pictures lie in the period [h, w] of the spectra."""

    def refocus(self, slopes: Slopes, weights: Tensor | None = None, fill: float = 1.0) -> Tensor:
        """Photographs through an aperture of cells, at any slopes.

        Args:
            slopes: Focus in pixels per view step, [N].
            weights: Synthetic aperture, >= 0, [V, U]; None weighs all cells alike.
            fill: Width of a cell in view steps, >= 0; 1 integrates over the aperture, 0 sums over points.

        Returns:
            Stacks in the order of the slopes, [..., N, C, H, W].

        Raises:
            InputError: Slopes, weights or a fill that cannot be used.
        """
        planes = geometry.checked_slopes(slopes, self.grid, self.frame.size)
        aperture, width = batches.checked_weights(weights, self.grid), layer_mixing.checked_fill(fill)
        distances = planes[:, None] - self.energies.disparities
        points = layer_mixing.of_points(distances, aperture, self.frame.period)
        seen = points.times(layer_mixing.of_cell(distances, width, self.frame.period))
        flat = self.spectra.reshape(-1, *self.spectra.shape[-4:])
        stack = self.frame.pictures(layer_mixing.multiplied(flat, seen))
        return stack.reshape(*self.spectra.shape[:-4], *stack.shape[1:])

    def view(self, v: float, u: float) -> Tensor:
        """What one viewpoint sees, with less noise; also between the views, or some way beyond them.

        Args:
            v: Row of the view, the first one 0; any number.
            u: Column of the view, the first one 0; any number.

        Returns:
            Pictures, [..., C, H, W].
        """
        above, left = ((n_views - 1) / 2 - place for n_views, place in zip(self.grid, (v, u), strict=True))
        disparities, (height, width) = self.energies.disparities, self.frame.period
        rows = fourier.shift_phases(fourier.frequencies(height), disparities * above).to(self.spectra)
        columns = fourier.shift_phases(fourier.half_frequencies(width), disparities * left).to(self.spectra)
        return self.frame.pictures((self.spectra * rows[:, None, :, None] * columns[:, None, None]).sum(-4))


def disparity_layers(
    views: Tensor,
    disparities: Slopes | None = None,
    n_layers: int = 12,
    ridge: float = RIDGE,
    weights: Tensor | None = None,
    border: str = "edge",
) -> Layers:
    """The layers that light fields are made of.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        disparities: Of the layers, in pixels per view step, [K]; None finds their range in the first light field.
        n_layers: How many, where disparities are to be found, >= 1.
        ridge: Noise, and all that is no layer, in the mean of the views, as a share of the light, above 0.
        weights: How much each view counts, >= 0, [V, U]; None counts all alike.
        border: `edge`: beyond the border the outermost pixel goes on; `wrap`: the opposite border follows.

    Returns:
        The layers, complex64 (complex128 for float64 views).

    Raises:
        InputError: An argument that cannot be used.

    Example:
        >>> layers = lfref.disparity_layers(torch.rand(5, 5, 3, 48, 64), disparities=[-1, 0, 1])
        >>> layers.refocus([0.5]).shape, layers.view(2, 1.5).shape
        (torch.Size([1, 3, 48, 64]), torch.Size([3, 48, 64]))
    """
    batch = batches.radiance(batches.flattened(views))
    grid, size = batches.grid_and_size(batch)
    aperture = batches.checked_weights(weights, grid)
    energies = expected(batch[0], disparities, n_layers, aperture)
    frame = layer_mixing.framed(border, size, geometry.corner_shift(energies.disparities, grid))
    seen = exact_fourier(frame.extended(batch), energies.disparities, aperture)
    spectra = fitted(torch.fft.rfft2(seen), energies, aperture, frame.period, ridge)
    return Layers(spectra.reshape(*views.shape[:-5], *spectra.shape[1:]), energies, grid, frame)


def expected(field: Tensor, disparities: Slopes | None, n_layers: int, aperture: Tensor) -> Energies:
    """Layers at the disparities given, which share the light evenly, or such as a light field holds.

    Args:
        field: Views, floating point, [V, U, C, H, W].
        disparities: As in `disparity_layers`.
        n_layers: As in `disparity_layers`.
        aperture: Weight of each view, their sum 1, [V, U].
    """
    if disparities is None:
        return layer_energies.found(field, n_layers, aperture)
    grid, size = batches.grid_and_size(field)
    return layer_energies.even(geometry.checked_slopes(disparities, grid, size))


def fitted(seen: Tensor, energies: Energies, aperture: Tensor, period: tuple[int, int], ridge: float) -> Tensor:
    """The ridge regression.

    Args:
        seen: Spectra of what is seen when the views are refocused exactly at the disparities, complex,
            [B, K, C, h, w // 2 + 1].
        energies: Of the layers.
        aperture: Weight of each view, their sum 1, [V, U].
        period: Height and width (h, w) of the pictures.
        ridge: As in `disparity_layers`.

    Returns:
        Spectra of the layers, complex, [B, K, C, h, w // 2 + 1].
    """
    if not (math.isfinite(ridge) and ridge > 0):
        raise InputError("ridge must be finite and above 0", got=ridge)
    distances = energies.disparities[:, None] - energies.disparities
    points, least = layer_mixing.of_points(distances, aperture, period), ROUNDING * torch.finfo(seen.dtype).eps
    return layer_mixing.solved(seen, points, max(ridge, least) / energies.shares)


# PART layered_refocusing
# Refocusing through an aperture with an area, each layer of the scene blurred by its own distance from the focus.
#
# Each view stands for a cell of the aperture, within which light at disparity d moves by |s - d| pixels: the sum over
# the
# views, a sum of points, lacks the factor `c(s - d)` of the cell (see `aperture_response`). Layers tell how much of
# each
# frequency is at which disparity; what they do not explain is taken to be at the middle one, m:
# `I^_s = c(s - m) E_s + sum_d (c(s - d) - c(s - m)) D(s - d) f_d^`, E exact refocusing and f the layers.
# So layers only correct what the cells do: without area (`fill` 0) this is exact refocusing, whatever they are.
# Letters: `N` planes, `K` layers, `s` slope, `d` disparity in pixels per view step; others as in `disparity_layers`.


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
    width = layer_mixing.checked_fill(fill)
    stacks = []
    for field in batch:  # each has layers of its own
        radiance = batches.radiance(field)
        energies = expected(radiance, disparities, n_layers, aperture)
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
    frame = layer_mixing.framed(border, size, geometry.corner_shift(torch.cat([planes, energies.disparities]), grid))
    return frame.pictures(_refocused(frame.extended(field), planes, energies, aperture, ridge, fill))


def _refocused(
    field: Tensor, planes: Tensor, energies: Energies, aperture: Tensor, ridge: float, fill: float
) -> Tensor:
    """Spectra of the planes, [N, C, h, w // 2 + 1], of periodic views, [V, U, C, h, w]."""
    period = batches.grid_and_size(field)[1]
    exact = torch.fft.rfft2(exact_fourier(field, torch.cat([planes, energies.disparities]), aperture))
    at_planes, at_layers = exact[None].split([len(planes), len(energies.disparities)], dim=1)
    layers = fitted(at_layers, energies, aperture, period, ridge)
    distances = planes[:, None] - energies.disparities
    from_middle = (planes - energies.disparities @ energies.shares)[:, None]
    of_middle = layer_mixing.of_cell(from_middle.expand_as(distances), fill, period)
    of_layers = layer_mixing.of_cell(distances, fill, period)
    correction = layer_mixing.of_points(distances, aperture, period).times(of_layers.minus(of_middle))
    cell = of_middle.rows[:, :1, 0, :, None] * of_middle.columns[:, :1, 0, None]
    return (cell.to(field) * at_planes + layer_mixing.multiplied(layers, correction))[0]
