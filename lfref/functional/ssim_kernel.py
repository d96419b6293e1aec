"""The compiled form of 1 - SSIM and of its gradient, row by row in float64: all that is between stays in the caches.

A Gaussian mean with reflection, and its adjoint, are bands of 11 weights that depend on the place; one loop serves
both. Letters: `x y` planes, `d = x - y`, `s = x + y`, `a b` as in `ssim`, `H W` rows and columns, `q` one of the four
fields d, s, d^2, s^2, each centred by its plane's mean first; `g` derivatives of 1 - SSIM.
"""

import functools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import compiled

RADIUS = 5
"""Pixels that the window reaches to each side."""
SIGMA = 1.5
TAPS = 2 * RADIUS + 1

Reals = NDArray[np.floating]


class Bands(NamedTuple):
    """Weights of each place of an axis of n pixels for its neighbours, 0 beyond the ends."""

    mean: Reals
    """Of the local mean, [n, 11]."""
    adjoint: Reals
    """Of its adjoint, [n, 11]."""


class Plan(NamedTuple):
    """What the loops need besides the images."""

    rows: Bands
    """Along the columns' direction, [H, 11]."""
    mean: Reals
    """Along a row, a tap after the other, [11, W]."""
    adjoint: Reals
    """[11, W]."""
    C1: float
    C2: float


class Scratch(NamedTuple):
    """What one thread works in."""

    fields: Reals
    """A row of the four fields, continued by zeros beyond its ends, [4, 5 + W + 5]."""
    ring: Reals
    """The last 11 rows, summed along themselves, used in turn, [11, 4, W]."""
    row: Reals
    """A row summed along both axes, [4, W]."""


def window() -> NDArray[np.float64]:
    """Normalised Gaussian weights of one axis, [11]."""
    weights = np.exp(-(np.arange(-RADIUS, RADIUS + 1.0) ** 2) / (2 * SIGMA**2))
    return weights / weights.sum()


@functools.lru_cache(maxsize=32)
def bands(n: int) -> Bands:
    """The weights of an axis.

    Args:
        n: Its length, above `RADIUS` pixels.
    """
    places, mean = np.arange(n), np.zeros((n, n))
    for offset, weight in zip(range(-RADIUS, RADIUS + 1), window(), strict=True):
        mean[places, n - 1 - abs(n - 1 - abs(places + offset))] += weight
    return Bands(_band(mean), _band(mean.T))


def _band(matrix: NDArray) -> NDArray:
    """The 11 diagonals of a matrix, row by row, [n, n] -> [n, 11]."""
    padded = np.pad(matrix, ((0, 0), (RADIUS, RADIUS)))
    return np.stack([padded[i, i : i + TAPS] for i in range(len(matrix))])


def plan(height: int, width: int, C1: float, C2: float) -> Plan:
    """The tables for planes of one size."""
    across = bands(width)
    return Plan(bands(height), np.ascontiguousarray(across.mean.T), np.ascontiguousarray(across.adjoint.T), C1, C2)


@compiled
def set_values(x: Reals, y: Reals, plan: Plan, values: Reals) -> None:
    """1 - SSIM of each plane.

    Args:
        x: Planes, [P, H, W].
        y: Planes, [P, H, W].
        plan: Of their size.
        values: Is set, float64, [P].
    """
    _, height, width = x.shape
    scratch = _scratch(width)
    for p in range(len(x)):
        centres, total = (_mean(x[p]), _mean(y[p])), np.zeros(width)
        scratch.ring[:] = 0
        for i in range(height + RADIUS):
            if i < height:
                _center(x[p, i], y[p, i], centres, scratch.fields)
                _filter_row(scratch.fields, plan.mean, scratch.ring[i % TAPS])
            if i >= RADIUS:
                _filter_columns(scratch.ring, plan.rows.mean[i - RADIUS], i - RADIUS, scratch.row)
                _add_values(scratch.row, plan, centres, total)
        values[p] = total.sum() / (height * width)


@compiled
def set_values_and_gradients(x: Reals, y: Reals, plan: Plan, values: Reals, g_x: Reals, g_y: Reals) -> None:
    """1 - SSIM of each plane, and its gradient.

    Args:
        x: Planes, [P, H, W].
        y: Planes, [P, H, W].
        plan: Of their size.
        values: Is set, float64, [P].
        g_x: Is set, [P, H, W]; or [P, 0, 0].
        g_y: Is set, [P, H, W]; or [P, 0, 0].
    """
    _, height, width = x.shape
    means, slopes = _scratch(width), _scratch(width)
    for p in range(len(x)):
        centres, total = (_mean(x[p]), _mean(y[p])), np.zeros(width)
        means.ring[:], slopes.ring[:] = 0, 0
        # Rows come in, those whose neighbours have come are compared, and those whose neighbours have been go out.
        for i in range(height + 2 * RADIUS):
            middle, last = i - RADIUS, i - 2 * RADIUS
            if i < height:
                _center(x[p, i], y[p, i], centres, means.fields)
                _filter_row(means.fields, plan.mean, means.ring[i % TAPS])
            if 0 <= middle < height:
                _filter_columns(means.ring, plan.rows.mean[middle], middle, means.row)
                _add_values_and_set_slopes(means.row, plan, centres, total, slopes.fields[:, RADIUS:])
                _filter_row(slopes.fields, plan.adjoint, slopes.ring[middle % TAPS])
            if last >= 0:
                _filter_columns(slopes.ring, plan.rows.adjoint[last], last, slopes.row)
                for sign, g in ((1, g_x), (-1, g_y)):
                    if g.size:
                        _combine(x[p, last], y[p, last], centres, slopes.row, sign, g[p, last])
        values[p] = total.sum() / (height * width)


@compiled
def _scratch(width: int) -> Scratch:
    return Scratch(np.zeros((4, width + 2 * RADIUS)), np.zeros((TAPS, 4, width)), np.empty((4, width)))


@compiled
def _mean(plane: Reals) -> float:
    """Mean of a plane, column by column: many short sums at once."""
    total = np.zeros(plane.shape[1])
    for row in plane:
        for j in range(len(row)):
            total[j] += row[j]
    return total.sum() / plane.size


@compiled
def _center(x: Reals, y: Reals, centres: tuple[float, float], fields: Reals) -> None:
    """A row of d, s and their squares, each plane centred by its mean: a large one would swamp the variance."""
    centre_d, centre_s = centres[0] - centres[1], centres[0] + centres[1]
    for j in range(len(x)):
        first, second = np.float64(x[j]), np.float64(y[j])
        d, s = first - second - centre_d, first + second - centre_s
        fields[0, RADIUS + j], fields[1, RADIUS + j] = d, s
        fields[2, RADIUS + j], fields[3, RADIUS + j] = d * d, s * s


@compiled
def _filter_row(fields: Reals, band: Reals, result: Reals) -> None:
    """Weighted sums along a row, [4, W + 10] -> [4, W]."""
    for q in range(4):
        row, total = fields[q], result[q]
        for j in range(len(total)):
            value = 0.0
            for k in range(TAPS):
                value += band[k, j] * row[j + k]
            total[j] = value


@compiled
def _filter_columns(ring: Reals, band: Reals, i: int, result: Reals) -> None:
    """Row i of the weighted sums down the columns, [11, 4, W] -> [4, W]."""
    for q in range(4):
        total = result[q]
        for j in range(len(total)):
            value = 0.0
            for k in range(TAPS):
                # Rows beyond the ends have weight 0; what lies in their places is another row, or zeros.
                value += band[k] * ring[(i + k + TAPS - RADIUS) % TAPS, q, j]
            total[j] = value


@compiled
def _add_values(row: Reals, plan: Plan, centres: tuple[float, float], total: Reals) -> None:
    """a + b - ab of a row."""
    centre_d, centre_s = centres[0] - centres[1], centres[0] + centres[1]
    for j in range(len(total)):
        mean_d, mean_s = row[0, j], row[1, j]
        squared_d, squared_s = (mean_d + centre_d) ** 2, (mean_s + centre_s) ** 2
        var_d, var_s = _positive(row[2, j] - mean_d * mean_d), _positive(row[3, j] - mean_s * mean_s)
        # mu_x^2 + mu_y^2 = (mu_s^2 + mu_d^2) / 2; numerators and denominators carry a factor of 2.
        a = 2 * squared_d / (squared_s + squared_d + 2 * plan.C1)
        b = 2 * var_d / (var_s + var_d + 2 * plan.C2)
        total[j] += a + b - a * b


@compiled
def _add_values_and_set_slopes(
    row: Reals, plan: Plan, centres: tuple[float, float], total: Reals, slopes: Reals
) -> None:
    """a + b - ab of a row, and the derivatives of its mean with respect to the four local means, [4, W]."""
    centre_d, centre_s = centres[0] - centres[1], centres[0] + centres[1]
    share = 1 / (len(plan.rows.mean) * len(total))
    for j in range(len(total)):
        mean_d, mean_s = row[0, j], row[1, j]
        mu_d, mu_s = mean_d + centre_d, mean_s + centre_s
        raw_d, raw_s = row[2, j] - mean_d * mean_d, row[3, j] - mean_s * mean_s
        var_d, var_s = _positive(raw_d), _positive(raw_s)
        luminance, structure = mu_s * mu_s + mu_d * mu_d + 2 * plan.C1, var_s + var_d + 2 * plan.C2
        a, b = 2 * mu_d * mu_d / luminance, 2 * var_d / structure
        total[j] += a + b - a * b
        g_a, g_b = 2 * share * (1 - b) / luminance, share * (1 - a) / structure
        # A variance that rounding made negative counts as 0 and has no slope.
        g_var_d, g_var_s = 0.0 if raw_d < 0 else (2 - b) * g_b, 0.0 if raw_s < 0 else -b * g_b
        slopes[0, j] = g_a * mu_d * (2 - a) - 2 * mean_d * g_var_d
        slopes[1, j] = -g_a * mu_s * a - 2 * mean_s * g_var_s
        slopes[2, j] = g_var_d
        slopes[3, j] = g_var_s


@compiled
def _positive(value: float) -> float:
    """The value, 0 instead of one below; not a number stays so."""
    return 0.0 if value < 0 else value


@compiled
def _combine(x: Reals, y: Reals, centres: tuple[float, float], fields: Reals, sign: int, g: Reals) -> None:
    """A row of the derivatives with respect to x (sign 1) or y (-1), from those of the four centred fields."""
    centre_d, centre_s = centres[0] - centres[1], centres[0] + centres[1]
    for j in range(len(g)):
        first, second = np.float64(x[j]), np.float64(y[j])
        g_d = fields[0, j] + 2 * (first - second - centre_d) * fields[2, j]
        g_s = fields[1, j] + 2 * (first + second - centre_s) * fields[3, j]
        g[j] = g_s + sign * g_d
