"""Separable Wiener refocusing: the photograph of a whole aperture, by one filter for each view row and view column.

`joint_wiener` solves for filters of all views together. Here each axis has its own (`axis_filters`), and their products
serve the views: the sum is that of exact refocusing, `filter_and_sum`, with other factors. The filters are solved for
the energies of the disparities (`estimate_energies`) and the noise (`noise_share`) that are found in the views.
An aperture that is no product of a row and a column, such as a disc, is a sum of few such products.
Letters: `N` planes, `V U` view rows and columns, `D` disparities, `s` slope, `d` disparity in pixels per view step.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from lfref import geometry
from lfref.functional import noise_line
from lfref.geometry import Slopes
from lfref.lightfield import LightField
from lfref.refocus import axis_filters, batches
from lfref.refocus.axis_filters import AxisSpectrum
from lfref.refocus.fourier import disparity_layers, layer_mixing
from lfref.refocus.fourier.disparity_layers import Energies, bounded_by_views
from lfref.refocus.fourier.exact import filter_and_sum
from lfref.refocus.operator import has_traits

SPECTRUM = AxisSpectrum(aliased=0.3, unexplained=0.002)
"""By trial on both versions of sim30. From .0003 to .01 of unexplained power, the mean of a scene
changes by at most .4 dB (eight scenes)."""
FINER = 4
"""Disparities of the prior for each layer of energy: light between two layers is at any disparity there."""
TAIL = 24
"""Pixels that filters reach beyond the shifts of the views."""
FAINT = 1e-4
"""Share of an aperture that is left out, of the largest of the products that it is the sum of."""
N_LAYERS = 12
"""Number of disparities whose energies are estimated, at least."""


class Term(NamedTuple):
    """A product of a row and a column of weights: part of an aperture."""

    rows: Tensor
    """Of the view rows, float64, [V]."""
    columns: Tensor
    """Of the view columns, float64, [U]."""


@has_traits("predicts", symmetric=True)
def separable_wiener(
    views: Tensor, slopes: Slopes, disparities: Slopes | None = None, weights: Tensor | None = None
) -> Tensor:
    """Refocus light fields as a lens with the whole aperture would, by filters of rows and columns.

    Linear in the views where disparities are given; where they are estimated, derivatives leave that out. Estimated
    wide ranges bound the picture by what the views show, as for layers.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        disparities: Of the light, each as likely, in pixels per view step, [D]; None: as each light field shows them.
        weights: Synthetic aperture of the photograph, >= 0, symmetric about both axes, [V, U]; each view stands for its
            cell of it. Views of weight 0 are read too. None: the whole square.

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views, [..., N, C, H, W].

    Raises:
        InputError: Views, slopes, disparities or weights that cannot be used.

    Example:
        >>> views = torch.rand(5, 5, 3, 48, 64)
        >>> lfref.separable_wiener(views, [-0.5, 0.5]).shape
        torch.Size([2, 3, 48, 64])
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    planes, aperture = geometry.checked_slopes(slopes, grid, size), batches.symmetric_weights(weights, grid)
    stacks = []
    for typed in batch:
        field = batches.radiance(typed)
        batches.check_finite(field)
        if disparities is not None:
            known = geometry.checked_slopes(disparities, grid, size)
            prior = Energies(known, torch.full_like(known, 1 / len(known)))
            stacks.append(refocus_by_rows_and_columns(field, planes, prior, aperture))
            continue
        energies = disparity_layers.estimate_energies(field, N_LAYERS, aperture)
        noise = noise_share(field, aperture, energies)
        stack = refocus_by_rows_and_columns(field, planes, finer(energies), aperture, noise)
        stacks.append(bounded_by_views(stack, field, planes, energies, aperture))
    return batches.restored(torch.stack(stacks), views)


def refocus_by_rows_and_columns(
    field: Tensor,
    planes: Tensor,
    prior: Energies,
    aperture: Tensor,
    noise: float = 0.0,
) -> Tensor:
    """A light field [V, U, C, H, W] refocused at planes [N] by a prior over its disparities, [N, C, H, W].

    The aperture [V, U], of sum 1, is symmetric about both axes; `noise` is that of `AxisSpectrum`.
    """
    grid, size = batches.grid_and_size(field)
    spectrum = SPECTRUM._replace(noise=noise)
    reaches = [math.ceil(float(planes.abs().max()) * (n_views - 1) / 2) + TAIL for n_views in grid]
    frame = layer_mixing.make_frame("edge", size, max(reaches))
    even, stack = torch.ones_like(aperture), torch.zeros(())
    for term in products(aperture):
        factors = []
        for n_views, weights, reach in zip(grid, term, reaches, strict=True):
            table = axis_filters.tables(spectrum, prior.disparities, planes, weights, 2 * reach)
            mean = prior.shares @ prior.disparities
            filters = axis_filters.filters(spectrum, table, planes, prior.shares[None], mean[None])[0]
            factors.append(axis_filters.kernels(filters, torch.zeros(n_views), 2 * reach))
        rows, columns = (_centred(taps, n) for taps, n in zip(factors, frame.period, strict=True))
        periods = filter_and_sum(field[None], torch.fft.fft(rows), torch.fft.rfft(columns), even, frame.extend)[0]
        stack = stack + frame.within(periods)
    return stack


def noise_share(field: Tensor, aperture: Tensor, energies: Energies) -> float:
    """`AxisSpectrum.noise` of a light field [V, U, C, H, W]: the smaller one of two measures, between views and within
    each view."""
    if int((aperture > 0).sum()) < 2:
        return 0.0
    rows, columns = (slice((n_views - 1) // 2, n_views // 2 + 1) for n_views in aperture.shape)
    central = field.detach()[rows, columns].mean((0, 1, 2))
    # Aliased views differ without noise, and textures are rough without it: both measures are upper bounds.
    shot, read = noise_line.measure(LightField(field.detach()))
    noise = min(energies.noise, shot * float(central.mean()) + read)
    grey = noise / field.shape[2]  # noise of the channels is independent, and their mean has less of it
    return noise / max(float(central.var()) - grey, noise, torch.finfo(torch.float32).tiny)


def finer(energies: Energies) -> Energies:
    """A prior with disparities between those of even energies: light is at any disparity between two layers."""
    known, shares = energies.disparities, energies.shares
    if len(known) == 1:
        return energies
    step = (known[-1] - known[0]) / (len(known) - 1)
    places = torch.arange(1 - FINER, FINER * len(known), dtype=torch.float64) / FINER
    weights = (1 - (places[:, None] - torch.arange(len(known))).abs()).clamp(min=0)
    finer_shares = weights @ shares
    return Energies(known[0] + step * places, finer_shares / finer_shares.sum(), energies.noise)


def products(aperture: Tensor) -> list[Term]:
    """The aperture [V, U] as a sum of products of a row and a column of weights, the largest first."""
    left, values, right = torch.linalg.svd(aperture.double().cpu())
    terms = []
    for column, value, row in zip(left.T, values, right, strict=False):
        if float(value) <= FAINT * float(values[0]):
            break
        # Weights of the columns have the sum 1 where they can: even weights then are exactly even.
        total = float(row.sum())
        scale = total if abs(total) > 1e-6 else 1.0
        terms.append(Term(column * value * scale, row / scale))
    return terms


def _centred(taps: Tensor, period: int) -> Tensor:
    """Taps [N, I, T] about 0 as one period of a sequence whose spectrum multiplies that of views, [N, I, period]."""
    # Taps read pixels at x + t: they are a correlation.
    whole = torch.zeros(*taps.shape[:-1], period, dtype=taps.dtype)
    whole[..., : taps.shape[-1]] = taps
    whole = whole.roll(-(taps.shape[-1] // 2), -1)
    return torch.cat([whole[..., :1], whole[..., 1:].flip(-1)], -1)
