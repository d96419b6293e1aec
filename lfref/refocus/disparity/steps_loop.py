"""The compiled loop of `refining`: how far each pixel's disparity is from where its views agree best.

Letters: `k` view, `y x` pixel row and column, `p q` position in a view along y and x, `t` fraction of a sample.
"""

import math

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import compiled, inlined

Reals = NDArray[np.float32]
Integers = NDArray[np.int64]
Number = float | np.floating
Taps = tuple[Number, Number, Number, Number]


@compiled
def find_steps(
    coefficients: Reals,
    places: Reals,
    middle: Integers,
    disparity: Reals,
    spread: Reals,
    top: int,
    information: Reals,
    steps: Reals,
) -> None:
    """The step of Gauss and Newton of a band of rows, and what it is worth.

    Args:
        coefficients: Cubic splines through the views, [K, H, W].
        places: v and u of each view, [K, 2].
        middle: Views to compare with at first.
        disparity: As far as it is known, [H, W].
        spread: Square of the difference that counts as half a disagreement, [H, W].
        top: First row of the band.
        information: Filled: sum of squares of what views change by with the disparity, [R, W].
        steps: Filled, in pixels per view step, 0 where nothing is known, [R, W].
    """
    n_views = len(coefficients)
    values, weights = np.empty(n_views, np.float32), np.empty(n_views, np.float32)
    gradients = np.empty((n_views, 2), np.float32)
    for i in range(steps.shape[0]):
        y = top + i
        for x in range(steps.shape[1]):
            _look(coefficients, places, y, x, disparity[y, x], values, gradients)
            reference = mean_of(values, middle)
            reference = weigh(values, reference, spread[y, x], weights)
            reference = weigh(values, reference, spread[y, x], weights)
            information[i, x], steps[i, x] = _step(values, gradients, places, weights, reference)


@inlined
def _look(
    coefficients: Reals, places: Reals, y: int, x: int, disparity: float, values: Reals, gradients: Reals
) -> None:
    """What each view shows of the point at a pixel, and its gradient there; NaN beyond its borders."""
    height, width = coefficients.shape[1:]
    for k in range(len(coefficients)):
        v, u = places[k]
        p, q = y + disparity * v, x + disparity * u
        if 0 <= p <= height - 1 and 0 <= q <= width - 1:
            values[k], gradients[k, 0], gradients[k, 1] = read_spline(coefficients[k], p, q)
        else:
            values[k] = np.nan


@inlined
def read_spline(view: Reals, p: float, q: float) -> tuple[Number, Number, Number]:
    """The spline at a position, and its derivatives along y and x."""
    height, width = view.shape
    row, column = int(p), int(q)
    (a, b, c, d), (da, db, dc, dd) = _spline(np.float32(p - row))
    (e, f, g, h), (de, df, dg, dh) = _spline(np.float32(q - column))
    left, right, after = abs(column - 1), _inside(column + 1, width), _inside(column + 2, width)
    value = along_y = along_x = np.float32(0)
    for n in range(4):
        line = view[_inside(row - 1 + n, height)]
        first, second, third, fourth = line[_inside(left, width)], line[column], line[right], line[after]
        here = e * first + f * second + g * third + h * fourth
        change = de * first + df * second + dg * third + dh * fourth
        weight = a if n == 0 else b if n == 1 else c if n == 2 else d
        derivative = da if n == 0 else db if n == 1 else dc if n == 2 else dd
        value += weight * here
        along_y += derivative * here
        along_x += weight * change
    return value, along_y, along_x


@inlined
def _inside(place: int, length: int) -> int:
    """The sample that mirrors go on with beyond both ends."""
    place = abs(place)
    return max(2 * (length - 1) - place, 0) if place >= length else place


@inlined
def _spline(t: float) -> tuple[Taps, Taps]:
    """Weights of the coefficients at -1, 0, 1 and 2 of a cubic spline, and of its derivative."""
    rest, sixth, half = np.float32(1) - t, np.float32(1 / 6), np.float32(0.5)
    first, last = rest * rest * rest * sixth, t * t * t * sixth
    second = np.float32(2 / 3) - half * t * t * (np.float32(2) - t)
    slope_first, slope_last = -half * rest * rest, half * t * t
    slope_second = t * (np.float32(1.5) * t - np.float32(2))
    return (first, second, np.float32(1) - first - second - last, last), (
        slope_first,
        slope_second,
        -slope_first - slope_second - slope_last,
        slope_last,
    )


@inlined
def mean_of(values: Reals, middle: Integers) -> Number:
    """Mean of those values in the middle that are there, 0 if none is."""
    total, count = np.float32(0), np.float32(0)
    for i in range(middle.size):
        value = values[middle[i]]
        if not math.isnan(value):
            total += value
            count += np.float32(1)
    return total / max(count, np.float32(1))


@inlined
def weigh(values: Reals, reference: Number, spread: float, weights: Reals) -> Number:
    """Weights of views by how well they agree with a reference, 0 of those without a sample; and their mean."""
    total, sum_of_weights = np.float32(0), np.float32(0)
    for k in range(values.size):
        off = values[k] - reference
        weight = spread / (spread + off * off)
        weights[k] = weight * weight if weight > 0 else np.float32(0)
        if weight > 0:
            total += weights[k] * values[k]
            sum_of_weights += weights[k]
    return total / sum_of_weights if sum_of_weights > 0 else reference


@inlined
def _step(values: Reals, gradients: Reals, places: Reals, weights: Reals, reference: Number) -> tuple[Number, Number]:
    """Information and step: least squares of what differs from the reference by what the disparity changes of it.

    What views change by is taken from the mean of their gradients: noise of each one's own would pass for information,
    and steps would fall short.
    """
    total = along_y = along_x = middle_v = middle_u = np.float32(0)
    for k in range(values.size):
        if weights[k] > 0:
            total += weights[k]
            along_y += weights[k] * gradients[k, 0]
            along_x += weights[k] * gradients[k, 1]
            middle_v += weights[k] * places[k, 0]
            middle_u += weights[k] * places[k, 1]
    share = np.float32(1) / max(total, np.float32(1e-12))
    along_y, along_x, middle_v, middle_u = share * along_y, share * along_x, share * middle_v, share * middle_u
    information, product = np.float32(0), np.float32(0)
    for k in range(values.size):
        if weights[k] > 0:
            change = (places[k, 0] - middle_v) * along_y + (places[k, 1] - middle_u) * along_x
            information += weights[k] * change * change
            product -= weights[k] * change * (values[k] - reference)
    return information, product / information if information > 0 else np.float32(0)
