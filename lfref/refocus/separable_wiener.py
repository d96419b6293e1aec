"""Separable Wiener refocusing: the photograph of a whole aperture, by one filter for each view row and view column.

`joint_wiener` solves for filters of all views together. Here each axis has its own (`axis_filters`), and their products
serve the views: the sum is that of exact refocusing, `filter_and_sum`, with other factors. The filters are solved for
the energies of the disparities and the noise that are found in the views (`scene`).
An aperture that is no product of a row and a column, such as a disc, is a sum of few such products.
Letters: `N` planes, `V U` view rows and columns, `D` disparities, `s` slope, `d` disparity in pixels per view step.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from lfref import geometry
from lfref.functional import fourier
from lfref.functional.devices import length_of, on_device, on_host
from lfref.geometry import Slopes
from lfref.refocus import axis_filters, batches
from lfref.refocus.axis_filters import AxisSpectrum
from lfref.refocus.bounds import bounded_by_views
from lfref.refocus.fourier import layer_mixing
from lfref.refocus.fourier.energies import Energies
from lfref.refocus.fourier.exact import filter_and_sum
from lfref.refocus.operator import has_traits
from lfref.refocus.scene import Scene, scenes_of
from lfref.refocus.shift.shifts import moved

SPECTRUM = AxisSpectrum(aliased=0.6, unexplained=0.002)
"""Edges alias: by trial on both versions of sim30 and on path-traced scenes, of which hair would gain 1 dB more with 1.
From .0003 to .01 of unexplained power, the mean of a scene changes by at most .4 dB (eight scenes)."""
FINER = 4
"""Disparities of the prior for each layer of energy: light between two layers is at any disparity there."""
TAIL = 24
"""Pixels that filters reach beyond the shifts of the views."""
FAINT = 1e-4
"""Share of an aperture that is left out, of the largest of the products that it is the sum of."""


class Term(NamedTuple):
    """A product of a row and a column of weights: part of an aperture."""

    rows: Tensor
    """Of the view rows, float64, [V]."""
    columns: Tensor
    """Of the view columns, float64, [U]."""


@has_traits("predicts", symmetric=True)
def separable_wiener(
    views: Tensor,
    slopes: Slopes,
    disparities: Slopes | None = None,
    weights: Tensor | None = None,
    scene: Scene | None = None,
) -> Tensor:
    """Refocus light fields as a lens with the whole aperture would, by filters of rows and columns.

    Linear in the views where disparities are given. Where they are estimated, derivatives leave that out, and the
    picture is bounded by what the views show in focus.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        disparities: Of the light, each as likely, in pixels per view step, [D]; None: as each light field shows them.
        weights: Synthetic aperture of the photograph, >= 0, symmetric about both axes, [V, U]; each view stands for its
            cell of it. Views of weight 0 are read too. None: the whole square.
        scene: What `analyze_scene` found in this one light field; None: it is analyzed.

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
    if disparities is not None:
        known = on_device(geometry.checked_slopes(disparities, grid, size), views.device)
        even = torch.full_like(known, 1 / len(known))
        prior, light = Energies(known, even, torch.zeros_like(known[0])), batches.radiance(batch)
        batches.check_finite(light)
        stacks = [refocus_by_rows_and_columns(field, planes, prior, aperture, noise=0.0) for field in light]
    else:
        stacks = [
            bounded_by_views(
                refocus_by_rows_and_columns(own.light, planes, finer(own.energies), aperture, own.noise),
                own,
                planes,
                aperture,
            )
            for own in scenes_of(batch, scene, weights)
        ]
    return batches.restored(stacks, views)


def refocus_by_rows_and_columns(
    field: Tensor, planes: Tensor, prior: Energies, aperture: Tensor, noise: Tensor | float
) -> Tensor:
    """A light field [V, U, C, H, W] refocused at planes [N] by a prior over its disparities, [N, C, H, W].

    The aperture [V, U], of sum 1, is symmetric about both axes; `noise` is that of `AxisSpectrum`.
    """
    grid, size = batches.grid_and_size(field)
    spectrum = SPECTRUM._replace(noise=noise)
    reaches = farthest_shift(planes, grid[0]) + TAIL, farthest_shift(planes, grid[1]) + TAIL
    frame = layer_mixing.make_frame("edge", size, reaches)
    slopes, mean = on_device(planes, field.device), prior.shares @ prior.disparities
    stacks = []
    for term in products(aperture):
        taps: list[Tensor] = []
        on_field = [on_device(weights, field.device) for weights in term]
        for own, other, reach in zip(on_field, reversed(on_field), reaches, strict=True):
            if taps and same_axes(term):
                taps.append(taps[0])
                continue
            table = axis_filters.tables(spectrum, prior.disparities, slopes, own, 2 * reach)
            beside = axis_filters.noise_beside(prior.disparities, prior.shares, slopes, other, 2 * reach)
            filters = axis_filters.filters(spectrum, table, slopes, prior.shares[None], mean[None], beside)[0]
            taps.append(axis_filters.kernels(filters, torch.zeros_like(own), 2 * reach))
        rows, columns = (
            fourier.transformed(own, period, is_half)
            for own, period, is_half in zip(taps, frame.period, (False, True), strict=True)
        )
        stacks.append(filter_and_sum(field[None], rows, columns, None, frame)[0])
    return stacks[0] if len(stacks) == 1 else torch.stack(stacks).sum(0)


@on_host
def same_axes(term: Term) -> bool:
    """Whether rows and columns of a product are alike, and have the same filters."""
    return term.rows.shape == term.columns.shape and torch.allclose(term.rows, term.columns)


def farthest_shift(planes: Tensor, n_views: int) -> int:
    """Pixels by which the outermost of some views is shifted at most, a whole number, at least 1."""
    outermost = torch.full((), (n_views - 1) / 2, dtype=torch.float64)
    return length_of(moved(planes.abs().amax(0)[None], outermost).ceil().long().clamp(min=1)[0])


def finer(energies: Energies) -> Energies:
    """A prior with disparities between those of even energies: light is at any disparity between two layers."""
    known, shares = energies.disparities, energies.shares
    if len(known) == 1:
        return energies
    step = (known[-1] - known[0]) / (len(known) - 1)
    places = torch.arange(1 - FINER, FINER * len(known), dtype=torch.float64, device=known.device) / FINER
    weights = (1 - (places[:, None] - torch.arange(len(known), device=known.device)).abs()).clamp(min=0)
    finer_shares = weights @ shares
    return Energies(known[0] + step * places, finer_shares / finer_shares.sum(), energies.noise)


@on_host
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
