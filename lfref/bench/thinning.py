"""A truth for captures of many views: what every second or third view should make is what all of them make.

All views, refocused exactly, are the dense integral: a sum over the same aperture in finer steps. The thinned views
stand for cells `step` times wider than those of the dense ones, and those at the ends for less, so that both apertures
are equal. Along one axis, in dense view steps from the centre, D dense views have cells of width 1 and span
[-D/2, D/2]. Every `step`-th view, n of them, has a cell of width `step`; the one at the end, at `step` (n - 1)/2,
would reach `step`/2 farther, and what lies beyond D/2 is not there. It counts by the share of its cell that is:

    share = (D/2 - step (n - 1)/2 + step/2) / step

Of 9 views every second makes 5, at -4 to 4: share = (4.5 - 4 + 1) / 2 = 3/4; every third makes 3, and share = 1. A rest
of views on both sides is kept on both, so that the centres are one; of 14 views, which every second cannot be taken of
about a centre, the last is left out. Slopes are those of the thinned views, `step` times the dense ones.

The dense views are points too: where all is far from focus, each stands for its cell, blurred by its distance from the
middle disparity, as in `shift_and_sum_through_cells`; else copies of edges would be part of the truth. What is left of
them is the error of this judge. Views are taken to be linear.
"""

import functools
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.bench.subjects import EXACT, Subject
from lfref.errors import InputError
from lfref.lightfield import LightField
from lfref.refocus import apertures
from lfref.refocus.disparity.disparity_range import disparity_range
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift import through_cells
from lfref.refocuser.operators import OperatorRefocuser

THINNED, DENSE = "thinned", "dense_integral"
"""The class of such subjects, and their reference."""


class Axis(NamedTuple):
    """Which views are taken along one angular axis."""

    dense: slice
    """For the integral, of all views."""
    thinned: slice
    """For the methods, of all views."""
    shares: Tensor
    """What each of these counts, in (0, 1], float64, [n]."""


def axis(n_views: int, step: int) -> Axis:
    """Choose views along one angular axis, as many as there can be.

    Args:
        n_views: Of the capture.
        step: Every how manieth view is kept, >= 2.

    Raises:
        InputError: Less than two views are left.
    """
    n_kept = (n_views - 1) // step + 1
    if step < 2 or n_kept < 2:
        expected = "every second view or fewer must be kept, and two at least"
        raise InputError(expected, got=f"every {step} of {n_views}", remedy="set thin=2, and reader.views to read more")
    reach = (n_kept - 1) * step
    start, odd = divmod(n_views - 1 - reach, 2)
    n_dense = n_views - odd
    shares = torch.ones(n_kept, dtype=torch.float64)
    shares[[0, -1]] = (n_dense - reach + step) / (2 * step)
    return Axis(slice(0, n_dense), slice(start, start + reach + 1, step), shares)


def thinned(fields: Iterable[LightField], step: int, slopes: Tensor) -> Iterator[Subject]:
    """Every `step`-th view of captures, to be judged by the dense integral.

    Args:
        fields: Of many views, linear, on the device where they are refocused.
        step: As for `axis`.
        slopes: In pixels per step of the thinned views, [N].

    Raises:
        InputError: Too few views.
    """
    exact = OperatorRefocuser(EXACT, dense_integral)
    for field in fields:
        rows, columns = (axis(n_views, step) for n_views in field.grid)
        weights = rows.shares[:, None] * columns.shares
        truth = exact(_taken(field, rows.dense, columns.dense), slopes / step)
        light = _taken(field, rows.thinned, columns.thinned)
        yield Subject(THINNED, light, truth, DENSE, functools.partial(apertures.mask, rows=weights))


def dense_integral(views: Tensor, slopes: Tensor) -> Tensor:
    """Exact refocusing, planes where all is out of focus through whole cells.

    Args:
        views: One light field, [V, U, C, H, W].
        slopes: In pixels per view step, [N].
    """
    boxes = through_cells.widths(slopes, disparity_range(views))
    planes = zip(slopes.tolist(), boxes.tolist(), strict=True)
    return torch.cat([exact_fourier(views, [slope], fill=1.0, disparity=slope - box) for slope, box in planes], -4)


def _taken(field: LightField, rows: slice, columns: slice) -> LightField:
    weight = None if field.weight is None else field.weight[rows, columns]
    return replace(field, views=field.views[rows, columns], weight=weight)
