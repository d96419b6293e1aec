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
Letters: `u v` view column and row, `N` planes, `K` layers, `F` frequencies, `h w` height and width of a period, `kx ky`
frequency in cycles per pixel, `s` slope, `d e` disparities in pixels per view step.

The energies p of the layers that a light field holds come from its own spectra (`estimate_energies`). At some hundred
frequencies the views, L = sum_k A_k f_k + noise with A the phases of layer k in each view, are modelled with layers
whose energies are the same at all frequencies. Expectation maximisation raises the likelihood step by step: the mean
and variance of f under the present p, then p = mean of |f|^2 + variance. A layer fades away if the others
explain all that it explains. A focus measure cannot do that: the aperture blurs it along the disparities.
Sources: Le Pendu, Guillemot, Smolic, "A Fourier Disparity Layer Representation for Light Fields", 2019; Tipping,
"Sparse Bayesian Learning and the Relevance Vector Machine", 2001 (energies).
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.functional.neighbours import box_max
from lfref.geometry import Slopes
from lfref.refocus import batches, footprint
from lfref.refocus.focus.slope_range import DisparityRange
from lfref.refocus.fourier import layer_mixing
from lfref.refocus.fourier.exact import filter_and_sum, frequencies, half_frequencies, shift_phases
from lfref.refocus.fourier.layer_mixing import Frame
from lfref.refocus.operator import has_traits
from lfref.refocus.shift.shift_and_sum import coverage, shift_and_sum, wide_range

RIDGE = 1e-3
"""Power of noise, and of all that is no layer, in the mean view, as a share of its power."""
REACH = 4.0
"""Disparities that are always tried, to either side of 0, in pixels per view step; `wide_range` may widen them."""
SPACING = 1.25
"""Largest distance of neighbouring layers in the outermost view, in pixels: light between two layers is blurred by half
of it."""
CONFUSABLE = 2.5
"""Range of disparities in pixels per view step from which layers confuse light at two disparities, e apart: detail of
1 / e cycles per pixel, in a row or a column, looks alike at both, and pictures end at about .4 cycles per pixel."""
RANGES, SHARES_OF_SPREAD = (5.0, 7.0), (0.15, 0.025)
"""Where layers are confused: the largest difference of a picture from the sum of its views, in standard deviations of
the views, at two ranges of disparities; between them in proportion. By trial, on the scenes `deep` and `apple` of
sim30, and `sim30.WIDE`."""
MOST_LAYERS = 96
"""Largest number of layers that a wide range gets: each layer needs the memory of a picture."""
STEP = 0.25
"""Distance of the layers that are tried, in pixels per view step."""
LEAST_SHARE = 0.01
"""Share of the energy that layers beyond the scene's range get from noise and occlusion: less does not count."""
OVER_NOISE = 3
"""Nor do shares below so many times the lower quartile of all: noise falls on all layers alike."""
N_STEPS = 8
"""Steps of the expectation maximisation."""
QUIET, QUIET_VARIANCE = 0.25, 0.9
"""Share of the frequencies that show nothing but noise, at most; what is left there of noise of variance 1."""
LOWEST, HIGHEST = 1 / 24, 0.4
"""Lowest and highest frequency that is read, in cycles per pixel: below, all layers look alike; above, views alias."""
_RADII = torch.logspace(math.log10(LOWEST), math.log10(HIGHEST), 12, dtype=torch.float64)[:, None]
_ANGLES = torch.pi * ((torch.arange(24, dtype=torch.float64) + 0.5) / 24 - 0.5)
FREQUENCIES = torch.stack([_RADII * _ANGLES.sin(), _RADII * _ANGLES.cos()]).flatten(1)
"""ky and kx of 12 circles, whose radii grow in equal ratios, at 24 angles each, float64, [2, 288]."""


class Energies(NamedTuple):
    """What layers hold of a light field."""

    disparities: Tensor
    """In pixels per view step, float64, CPU, [K]."""
    shares: Tensor
    """Shares of the energy at any frequency, together 1, float64, CPU, [K]."""
    noise: float = 0.0
    """Variance of white noise in the views, in square light: an upper bound, since layers leave more than noise."""


class _Sample(NamedTuple):
    """Views at some frequencies: each frequency of energy 1, each view times the root of its weight."""

    spectra: Tensor
    """Complex128, [F, V U]."""
    turns: Tensor
    """kx (u - u0) + ky (v - v0), [F, V U]."""
    roots: Tensor
    """Roots of the views' weights, [V U]."""
    variance: Tensor
    """Variance of white noise that has all the energy of a frequency, in square light, [F]."""


def estimate_energies(views: Tensor, n_layers: int, aperture: Tensor) -> Energies:
    """At least `n_layers` even layers, `SPACING` apart or less, over the disparities that a light field [V, U, C, H, W]
    holds. The aperture [V, U] is of sum 1."""
    sample = _sampled(views, aperture)
    low, high = _held(sample, views, wide_range(views.detach(), aperture))
    outermost = (max(aperture.shape) - 1) / 2
    needed = min(1 + math.ceil((high - low) * outermost / SPACING), MOST_LAYERS)
    # Numbers below 1 are left for `even_slopes` to refuse.
    return _maximised(sample, geometry.even_slopes(max(n_layers, needed) if n_layers > 0 else n_layers, low, high))


def energy_range(views: Tensor, aperture: Tensor, known: DisparityRange | None) -> tuple[float, float]:
    """Least and largest disparity at which the spectra of a light field hold light; `known`: its range, if wide."""
    return _held(_sampled(views, aperture), views, known)


def _sampled(views: Tensor, aperture: Tensor) -> _Sample:
    """Views [V, U, C, H, W] at some hundred frequencies."""
    height, width = views.shape[-2:]
    y, x = sampled_bins(height, width)
    # Circles of small pictures share bins.
    y, x = torch.stack([y % height, x]).unique(dim=1)
    read = batches.without_unread(views.detach()[None], aperture)[0]
    # One view row at a time: all spectra together take as much memory as a channel of the views.
    rows = (torch.fft.rfft2(batches.radiance(row).sum(-3)) for row in read)
    spectra = torch.stack([row[..., y.to(row.device), x.to(row.device)] for row in rows]).cpu().to(torch.complex128)
    roots = aperture.sqrt()
    weighted = (spectra * roots[..., None]).flatten(0, 1).T
    energy = weighted.abs().square().sum(1, keepdim=True)
    ky, kx = frequencies(height)[y, None, None], half_frequencies(width)[x, None, None]
    v, u = (geometry.angular_offsets(n_views) for n_views in aperture.shape)
    sample = _Sample(
        weighted / energy.sqrt().clamp(min=torch.finfo(torch.float32).tiny),  # black views have no energy
        (ky * v[:, None] + kx * u).flatten(1),
        roots.flatten(),
        energy[:, 0] / views.shape[-3:].numel(),
    )
    if not bool(sample.spectra.isfinite().all()):
        raise InputError("views must be finite", got="NaN or infinity", remedy="mend the file")
    return sample


def sampled_bins(height: float | Tensor, width: float | Tensor) -> tuple[Tensor, Tensor]:
    """Rows, which may be negative, and columns of the bins of `rfft2` nearest to `FREQUENCIES`, int64, [288] both."""
    y, x = (FREQUENCIES[0] * height).round(), (FREQUENCIES[1] * width).round()
    return y.long(), x.long()


def _held(sample: _Sample, views: Tensor, known: DisparityRange | None) -> tuple[float, float]:
    """Ends of the layers that hold light, of a grid of layers as far as the scene reaches and the views can shift."""
    grid, size = batches.grid_and_size(views)
    limit = min(length / max(n - 1, 1) for n, length in zip(grid, size, strict=True))
    low, high = (-REACH, REACH) if known is None else (min(-REACH, known.low), max(REACH, known.high))
    n_below, n_above = (max(math.ceil(min(side, limit - STEP) / STEP), 0) for side in (-low, high))
    wide = _maximised(sample, torch.arange(-n_below, n_above + 1, dtype=torch.float64) * STEP)
    least = max(LEAST_SHARE, OVER_NOISE * float(wide.shares.quantile(0.25)))
    held = wide.disparities[wide.shares >= min(least, float(wide.shares.max()))].tolist()
    # Spectra miss surfaces that fill little of the picture, which the sweep over small views has found.
    surfaces = () if known is None or known.sure is None else known.sure
    return min([*held, *surfaces]) - STEP / 2, max([*held, *surfaces]) + STEP / 2


def _maximised(sample: _Sample, disparities: Tensor) -> Energies:
    """The energies of these layers under which the sample is most likely, as far as the steps lead."""
    turns = -2 * torch.pi * sample.turns[..., None] * disparities
    model = torch.polar(sample.roots[:, None].expand_as(turns), turns)
    gram, explained = model.mH @ model, (model.mH @ sample.spectra[..., None])[..., 0]
    n_views = float(1 / sample.roots.pow(4).sum())  # as many equal weights would be as uneven
    shares, noise = torch.full_like(disparities, 1 / len(disparities)), 0.01
    eye = torch.eye(len(disparities), dtype=gram.dtype)
    for _ in range(N_STEPS):
        # Expectation: mean of the layers and their variance. Written with roots of the shares, which may reach 0.
        root = shares.sqrt()
        inverse = torch.cholesky_inverse(torch.linalg.cholesky(root[:, None] * gram * root + noise * eye))
        layers = root * (inverse @ (root * explained)[..., None])[..., 0]
        variance = noise * inverse.diagonal(dim1=1, dim2=2).real
        rest = (sample.spectra - (model @ layers[..., None])[..., 0]).abs().square().sum(1)
        freedom = n_views - (1 - variance).sum(1)
        # Maximisation: shares and noise that make this expectation most likely. A scene of layers at exactly these
        # disparities leaves no noise, and a noise of 0 no inverse.
        shares = (layers.abs().square() + shares * variance).mean(0)
        noise = max(float(rest.sum() / freedom.sum()), 1e-6)
    # Occlusion and gloss add to what is left, at some frequencies more than at others.
    quiet = float((rest / freedom * n_views * sample.variance).quantile(QUIET)) / QUIET_VARIANCE
    return Energies(disparities, shares / shares.sum(), quiet)


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
        distances, period = planes[:, None] - self.energies.disparities, self.frame.period
        points = layer_mixing.aperture_response(distances, aperture, period)
        response = points.times(layer_mixing.cell_response(distances, fill_factor, period))
        flat = self.spectra.reshape(-1, *self.spectra.shape[-4:])
        stack = self.frame.pictures(layer_mixing.multiply(flat, response))
        return stack.reshape(*self.spectra.shape[:-4], *stack.shape[1:])

    def view(self, v: float, u: float) -> Tensor:
        """Pictures [..., C, H, W] from row v and column u of the views, between them, or some way beyond them."""
        above, left = ((n_views - 1) / 2 - position for n_views, position in zip(self.grid, (v, u), strict=True))
        disparities, (height, width) = self.energies.disparities, self.frame.period
        rows = shift_phases(frequencies(height), disparities * above).to(self.spectra)
        columns = shift_phases(half_frequencies(width), disparities * left).to(self.spectra)
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
    energies = _energies(batch[0], disparities, n_layers, aperture)
    frame = layer_mixing.make_frame(border, size, geometry.corner_shift(energies.disparities, grid))
    exact = _exact(batch, frame, energies.disparities, aperture)
    spectra = _fit(exact, energies, aperture, frame.period, ridge)
    return Layers(spectra.reshape(*views.shape[:-5], *spectra.shape[1:]), energies, grid, frame)


@has_traits("predicts")
def refocus_by_layers(
    views: Tensor,
    slopes: Slopes,
    disparities: Slopes | None = None,
    n_layers: int = 12,
    ridge: float = RIDGE,
    fill_factor: float = 1.0,
    weights: Tensor | None = None,
    border: str = "edge",
) -> Tensor:
    """Refocus light fields as a lens with the whole aperture would, by Fourier disparity layers.

    Linear in the views where disparities are given; where they are estimated, derivatives leave that out. Estimated
    wide ranges bound the picture by what the views show (`bounded_by_views`).

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        disparities: Of the layers, in pixels per view step, [K]; None: an even range over those of each light field.
        n_layers: Number of layers where no disparities are given, >= 1.
        ridge: As in `disparity_layers`, above 0.
        fill_factor: Width of the cell that a view stands for, in view steps, >= 0; 1 leaves no gaps, 0 sums points.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.
        border: `edge`: the outermost pixels go on beyond the border; `wrap`: the opposite border follows.

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
    width = footprint.checked(fill_factor, 0.0, views).fill_factor
    stacks = []
    for field in batch:  # each has its own layers
        radiance = batches.radiance(field)
        energies = _energies(radiance, disparities, n_layers, aperture)
        # The bound is no linear function of the views, and its sums have no period.
        is_free = disparities is None and fill_factor == 1 and border == "edge"
        stack = refocus_by_energies(radiance, planes, energies, aperture, ridge, width, border)
        stacks.append(bounded_by_views(stack, radiance, planes, energies, aperture) if is_free else stack)
    return batches.restored(torch.stack(stacks), views)


def bounded_by_views(stack: Tensor, field: Tensor, planes: Tensor, energies: Energies, aperture: Tensor) -> Tensor:
    """A stack [N, C, H, W] of layers; where they confuse light, no farther from the sum of the views than views differ.

    Pixels that some view does not see stay as they are.
    """
    reach = float(energies.disparities[-1] - energies.disparities[0])
    if reach <= CONFUSABLE:
        return stack
    share = float(np.interp(reach, RANGES, SHARES_OF_SPREAD))
    grid, size = batches.grid_and_size(field)
    with torch.no_grad():
        points = shift_and_sum(field, planes, "cubic", weights=aperture)
        squares = shift_and_sum(field.square(), planes, "cubic", weights=aperture)
        spread = (squares - points.square()).clamp(min=0).sqrt().amax(1, keepdim=True)
        bound = share * box_max(spread, 3)
        is_covered = coverage(planes, grid, size, weights=aperture)[:, None] > 0.999  # 1, but for rounding
        bound = torch.where(is_covered.to(bound.device), bound, torch.inf)
    return torch.maximum(torch.minimum(stack, points + bound), points - bound)


def refocus_by_energies(
    field: Tensor,
    planes: Tensor,
    energies: Energies,
    aperture: Tensor,
    ridge: float = RIDGE,
    fill_factor: float = 1.0,
    border: str = "edge",
) -> Tensor:
    """One light field [V, U, C, H, W] refocused at the planes by layers of known energies, [N, C, H, W]."""
    grid, size = batches.grid_and_size(field)
    slopes = torch.cat([planes, energies.disparities])
    frame = layer_mixing.make_frame(border, size, geometry.corner_shift(slopes, grid))
    # 1. Exact refocusing E at the planes, and at the layers as the right side of the regression.
    exact = _exact(field[None], frame, slopes, aperture)
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


def _exact(batch: Tensor, frame: Frame, slopes: Tensor, aperture: Tensor) -> Tensor:
    """Spectra of exact refocusing of views [B, V, U, C, H, W] in a frame, [B, N, C, h, w // 2 + 1]."""
    planes = geometry.checked_slopes(slopes, batches.grid_and_size(batch)[0], frame.period)
    v, u = (geometry.angular_offsets(n_views) for n_views in aperture.shape)
    rows = shift_phases(frequencies(frame.period[0]), planes[:, None] * v)
    columns = shift_phases(half_frequencies(frame.period[1]), planes[:, None] * u)
    return torch.fft.rfft2(filter_and_sum(batch, rows, columns, aperture, frame.extend))


def _energies(field: Tensor, disparities: Slopes | None, n_layers: int, aperture: Tensor) -> Energies:
    """Layers at the given disparities, which share the light evenly, or those that the light field holds."""
    if disparities is None:
        return estimate_energies(field, n_layers, aperture)
    planes = geometry.checked_slopes(disparities, *batches.grid_and_size(field))
    return Energies(planes, torch.full_like(planes, 1 / len(planes)))


def _fit(exact: Tensor, energies: Energies, aperture: Tensor, period: tuple[int, int], ridge: float) -> Tensor:
    """The ridge regression: spectra of the layers of those of exact refocusing at them, [B, K, C, h, w // 2 + 1]."""
    if not (math.isfinite(ridge) and ridge > 0):
        raise InputError("ridge must be finite and above 0", got=ridge)
    distances = energies.disparities[:, None] - energies.disparities
    gram = layer_mixing.aperture_response(distances, aperture, period)
    # A ridge within the rounding of G would leave Cholesky's roots negative.
    least = 100 * torch.finfo(exact.dtype).eps
    return layer_mixing.solve(exact, gram, max(ridge, least) / energies.shares)
