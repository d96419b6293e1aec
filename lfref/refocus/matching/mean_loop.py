"""The compiled loop of `extended_focus`: at each pixel the mean of the views that show its point.

Letters: `k` view, `c` channel, `y x` pixel row and column.
"""

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import compiled
from lfref.refocus.matching.steps_loop import Integers, Reals, mean_of, read_spline, weigh


@compiled
def weigh_views(
    coefficients: Reals,
    places: Reals,
    middle: Integers,
    disparity: Reals,
    spread: Reals,
    top: int,
    weights: NDArray[np.float32],
) -> None:
    """How far each view shows the point at each pixel of a band of rows.

    Args:
        coefficients: Cubic splines through grey views, [K, H, W].
        places: v and u of each view, [K, 2].
        middle: Views to compare with at first.
        disparity: In pixels per view step, [H, W].
        spread: Square of the difference that counts as half a disagreement, [H, W].
        top: First row of the band.
        weights: Filled, 0 of views without a sample there, else up to 1, [R, W, K].
    """
    n_views, height, width = coefficients.shape
    values = np.empty(n_views, np.float32)
    for i in range(weights.shape[0]):
        y = top + i
        for x in range(width):
            for k in range(n_views):
                p, q = y + disparity[y, x] * places[k, 0], x + disparity[y, x] * places[k, 1]
                values[k] = np.nan
                if 0 <= p <= height - 1 and 0 <= q <= width - 1:
                    values[k] = read_spline(coefficients[k], p, q)[0]
            reference = weigh(values, mean_of(values, middle), spread[y, x], weights[i, x])
            weigh(values, reference, spread[y, x], weights[i, x])


@compiled
def add_views(
    coefficients: Reals, places: Reals, disparity: Reals, weights: Reals, top: int, picture: NDArray[np.float32]
) -> None:
    """One channel of the weighted mean of a band of rows.

    Args:
        coefficients: Cubic splines through this channel of the views, [K, H, W].
        places: v and u of each view, [K, 2].
        disparity: In pixels per view step, [H, W].
        weights: As `weigh_views` leaves them, [R, W, K].
        top: First row of the band.
        picture: Filled, 0 where no view has a sample, [R, W].
    """
    for i in range(picture.shape[0]):
        y = top + i
        for x in range(picture.shape[1]):
            total, sum_of_weights = np.float32(0), np.float32(0)
            for k in range(len(coefficients)):
                weight = weights[i, x, k]
                if weight > 0:
                    p, q = y + disparity[y, x] * places[k, 0], x + disparity[y, x] * places[k, 1]
                    total += weight * read_spline(coefficients[k], p, q)[0]
                    sum_of_weights += weight
            picture[i, x] = total / max(sum_of_weights, np.float32(1e-12))
