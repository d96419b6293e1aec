"""Fourier disparity layers: views as a sum of shifted layers, from which any photograph of the scene follows.

`L^[v, u](k) = sum_d f_d^(k) exp(-2 pi i d ((u - u0) kx + (v - v0) ky))`, the f_d by one ridge regression a frequency:
`(G + ridge / p) f = B`, where `B_d` is exact refocusing at disparity d, `G_de = D(d - e)` the response of the aperture
(see `layer_mixing`) and p the share of the light that each layer is expected to hold.
What layers cannot explain (occlusion, gloss, reflections, disparities between theirs) is missing from pictures of
layers alone (`Layers.refocus`, `Layers.view`).

`refocus_by_layers` keeps it. Each view stands for a cell of the aperture, within which light at disparity d moves by
|s - d| pixels; exact refocusing E, a sum of points, lacks the factor `c(s - d)` of the cell. Layers say how much light
of each frequency is at which disparity; the rest counts as light at the mean disparity m:
`I^_s = c(s - m) E_s + sum_d (c(s - d) - c(s - m)) D(s - d) f_d^`.
So layers only correct what the cells do: without area (`fill_factor` 0) this is exact refocusing with any layers.
The energies p of the layers that a light field holds come from its own spectra (`energies`).
Letters: `u v` view column and row, `N` planes, `K` layers, `h w` height and width of a period, `kx ky` frequency in
cycles per pixel, `s` slope, `d e` disparities in pixels per view step.
Source: Le Pendu, Guillemot, Smolic, "A Fourier Disparity Layer Representation for Light Fields", 2019.
"""

import dataclasses
import math

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.functional.devices import is_known, on_device
from lfref.functional.fourier import Frame, frequencies, half_frequencies, shift_phases
from lfref.geometry import Slopes
from lfref.refocus import batches, footprint
from lfref.refocus.bounds import bounded_by_views
from lfref.refocus.fourier import energies as layer_energies
from lfref.refocus.fourier import layer_mixing
from lfref.refocus.fourier.energies import Energies
from lfref.refocus.fourier.exact import spectra_of_sum
from lfref.refocus.operator import has_traits
from lfref.refocus.scene import N_LAYERS, Scene, analyze_scene, scenes_of

RIDGE = 1e-3
"""Power of noise, and of all that is no layer, in the mean view, as a share of its power."""


@dataclasses.dataclass(frozen=True, eq=False)
class Layers:
    """A light field as layers, each at one disparity."""

    spectra: Tensor
    """The layers as the central viewpoint sees them, complex, [..., K, C, h, w // 2 + 1]."""
    energies: Energies
    """Their disparities, and the shares of the light that they were expected to hold."""
    grid: tuple[int, int]
    """Number of view rows and columns (V, U)."""
    frame: Frame
    """Where the pictures lie in the period [h, w] of the spectra."""

    def refocus(self, slopes: Slopes, weights: Tensor | None = None, fill_factor: float = 1.0) -> Tensor:
        """Photographs at slopes [N] through cells of weights [V, U], `fill_factor` view steps wide: stacks."""
        planes = geometry.checked_slopes(slopes, self.grid, self.frame.size)
        aperture = batches.checked_weights(weights, self.grid)
        distances, period = planes.to(self.spectra.device)[:, None] - self.energies.disparities, self.frame.period
        points = layer_mixing.aperture_response(distances, aperture, period)
        response = points.times(layer_mixing.cell_response(distances, fill_factor, period))
        flat = self.spectra.reshape(-1, *self.spectra.shape[-4:])
        stack = self.frame.pictures(layer_mixing.multiply(flat, response))
        return stack.reshape(*self.spectra.shape[:-4], *stack.shape[1:])

    def view(self, v: float, u: float) -> Tensor:
        """Pictures [..., C, H, W] from row v and column u of the views, between them, or some way beyond them."""
        above, left = ((n_views - 1) / 2 - position for n_views, position in zip(self.grid, (v, u), strict=True))
        disparities, (height, width) = self.energies.disparities, self.frame.period
        device = self.spectra.device
        rows = torch.complex(*shift_phases(frequencies(height, device), disparities * above)).to(self.spectra)
        columns = torch.complex(*shift_phases(half_frequencies(width, device), disparities * left)).to(self.spectra)
        return self.frame.pictures((self.spectra * rows[:, None, :, None] * columns[:, None, None]).sum(-4))


def disparity_layers(
    views: Tensor,
    disparities: Slopes | None = None,
    n_layers: int = N_LAYERS,
    ridge: float = RIDGE,
    weights: Tensor | None = None,
    border: str = "edge",
) -> Layers:
    """The layers that light fields are made of.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        disparities: Of the layers, in pixels per view step, [K]; None: an even range over those of the first field.
        n_layers: Number of layers where no disparities are given, >= 1.
        ridge: Power of noise, and of all that is no layer, in the mean view, as a share of its power, above 0.
        weights: Weight of each view, >= 0, [V, U]; None weighs all alike.
        border: `edge`: the outermost pixels go on beyond the border; `wrap`: the opposite border follows.

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
    scene = analyze_scene(batch[0], weights) if disparities is None else None
    energies = _energies(batch, disparities, n_layers, scene)
    reach = geometry.corner_shift(energies.disparities, grid)
    frame = layer_mixing.make_frame(border, size, (reach, reach))
    exact = _exact(batch, frame, energies.disparities, aperture)
    spectra = _fit(exact, energies, aperture, frame.period, ridge)
    return Layers(spectra.reshape(*views.shape[:-5], *spectra.shape[1:]), energies, grid, frame)


@has_traits("predicts")
def refocus_by_layers(
    views: Tensor,
    slopes: Slopes,
    disparities: Slopes | None = None,
    n_layers: int = N_LAYERS,
    ridge: float = RIDGE,
    fill_factor: float = 1.0,
    weights: Tensor | None = None,
    border: str = "edge",
    scene: Scene | None = None,
) -> Tensor:
    """Refocus light fields as a lens with the whole aperture would, by Fourier disparity layers.

    Linear in the views where disparities are given. Where they are estimated, derivatives leave that out, and the
    picture is bounded by what the views show in focus (`bounded_by_views`).

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        disparities: Of the layers, in pixels per view step, [K]; None: an even range over those of each light field.
        n_layers: Number of layers where no disparities are given, >= 1.
        ridge: As in `disparity_layers`, above 0.
        fill_factor: Width of the cell that a view stands for, in view steps, >= 0; 1 leaves no gaps, 0 sums points.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.
        border: `edge`: the outermost pixels go on beyond the border; `wrap`: the opposite border follows.
        scene: What `analyze_scene` found in this one light field; None: it is analyzed.

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
    width, stacks = footprint.checked(fill_factor, 0.0, views).fill_factor, []
    known = [None] * len(batch) if disparities is not None else scenes_of(batch, scene, weights)
    for field, own in zip(batch, known, strict=True):  # each has its own layers
        radiance = batches.radiance(field)
        energies = _energies(batch, disparities, n_layers, own)
        ends = energies.disparities
        if own is not None and not is_known(ends):
            # Layers that the host does not know lie within the disparities that are tried.
            ends = torch.tensor(layer_energies.farthest(own.known))
        reach = geometry.corner_shift(torch.cat([planes, ends]), grid)
        frame = layer_mixing.make_frame(border, size, (reach, reach))
        stack = _refocused(radiance, planes, energies, aperture, ridge, width, frame)
        # The bound is no linear function of the views, and its sums have no period.
        is_free = own is not None and fill_factor == 1 and border == "edge"
        stacks.append(bounded_by_views(stack, own, planes, aperture) if is_free and own is not None else stack)
    return batches.restored(stacks, views)


def _refocused(
    field: Tensor,
    planes: Tensor,
    energies: Energies,
    aperture: Tensor,
    ridge: float,
    fill_factor: float,
    frame: Frame,
) -> Tensor:
    """One light field [V, U, C, H, W] refocused at the planes by layers of known energies, [N, C, H, W]."""
    planes = on_device(planes, field.device)
    # 1. Exact refocusing E at the planes, and at the layers as the right side of the regression.
    exact = _exact(field[None], frame, torch.cat([planes, energies.disparities]), aperture)
    at_planes, at_layers = exact.split([len(planes), len(energies.disparities)], dim=1)
    # 2. The layers.
    layers = _fit(at_layers, energies, aperture, frame.period, ridge)
    # 3. Correction by each layer: (c(s - d) - c(s - m)) D(s - d).
    distances = planes[:, None] - energies.disparities
    from_mean = (planes - energies.disparities @ energies.shares)[:, None]
    mean_cell = layer_mixing.cell_response(from_mean.expand_as(distances), fill_factor, frame.period)
    layer_cells = layer_mixing.cell_response(distances, fill_factor, frame.period)
    points = layer_mixing.aperture_response(distances, aperture, frame.period)
    correction = layer_mixing.multiply(layers, points.times(layer_cells.minus(mean_cell)))
    # 4. c(s - m) E, written out: one factor a frequency and plane. Plane by plane, in place of the correction.
    cell = mean_cell.rows[:, :1, 0, :, None] * mean_cell.columns[:, :1, 0, None]
    for n, factor in enumerate(cell.to(field)):
        correction[0, n] += factor * at_planes[0, n]
    return frame.pictures(correction[0])


def _exact(batch: Tensor, frame: Frame, planes: Tensor, aperture: Tensor) -> Tensor:
    """Spectra of exact refocusing of views [B, V, U, C, H, W] in a frame, [B, N, C, h, w // 2 + 1]."""
    v, u = (geometry.angular_offsets(n_views, batch.device) for n_views in aperture.shape)
    rows = shift_phases(frequencies(frame.period[0], batch.device), planes[:, None] * v)
    columns = shift_phases(half_frequencies(frame.period[1], batch.device), planes[:, None] * u)
    read = batches.without_unread(batch, aperture)
    return spectra_of_sum(read, rows, columns, aperture, frame)


def _energies(batch: Tensor, disparities: Slopes | None, n_layers: int, scene: Scene | None) -> Energies:
    """Layers at the given disparities, which share the light evenly, or those that the scene holds."""
    if scene is not None:
        return scene.energies if n_layers == N_LAYERS else scene.energies_of(n_layers)
    assert disparities is not None
    planes = on_device(geometry.checked_slopes(disparities, *batches.grid_and_size(batch)), batch.device)
    return Energies(planes, torch.full_like(planes, 1 / len(planes)), torch.zeros_like(planes[0]))


def _fit(exact: Tensor, energies: Energies, aperture: Tensor, period: tuple[int, int], ridge: float) -> Tensor:
    """The ridge regression: spectra of the layers of those of exact refocusing at them, [B, K, C, h, w // 2 + 1]."""
    if not (math.isfinite(ridge) and ridge > 0):
        raise InputError("ridge must be finite and above 0", got=ridge)
    distances = energies.disparities[:, None] - energies.disparities
    gram = layer_mixing.aperture_response(distances, aperture, period)
    # A ridge within the rounding of G would leave Cholesky's roots negative. Layers without energy hold nothing.
    least = 100 * torch.finfo(exact.dtype).eps
    return layer_mixing.solve(exact, gram, max(ridge, least) / energies.shares.clamp(min=1e-12))
