"""Wiener filters: plain complex least squares, frequency by frequency; priors and power spectra."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.refocus import apertures, batches, wiener_filters
from lfref.refocus.wiener_filters import Prior, filters, opposites

KNOWN = Prior((-0.7, 0.1, 0.35), (0.3, 0.5, 0.2), aliased=0.15, unexplained=0.02, noise=0.05)
SLOPES = (-1.2, 0.0, 0.3)
SIDE = 8
GRIDS = [(3, 3), (2, 4), (5, 1), (3, 2), (1, 1)]


def offsets(grid):
    """Row and column of each view from the centre, row by row."""
    rows, columns = (np.arange(n) - (n - 1) / 2 for n in grid)
    return list(itertools.product(rows, columns))


def lens(aperture, places, blur, q):
    """What an aperture of weighted square cells does to a frequency `q` of light `blur` from the focus."""
    turns = [blur * (v * q[0] + u * q[1]) for v, u in places]
    return np.dot(aperture, np.exp(2j * np.pi * np.array(turns))) * np.sinc(blur * q[0]) * np.sinc(blur * q[1])


def by_least_squares(known, slopes, grid, aperture, k):
    """Factors [N, V U] at one frequency: 49 unknowns, every covariance added up term by term."""
    places, weights = offsets(grid), aperture.flatten().tolist()
    covariance = np.zeros((len(places),) * 2, complex)
    wanted = np.zeros((len(slopes), len(places)), complex)
    total = 0.0
    for fold in itertools.product((-1, 0, 1), repeat=2):
        q = np.array(k) + fold
        power = float(known.power(torch.tensor(q[0]), torch.tensor(q[1])))
        total += power
        for disparity, share in zip(known.disparities, known.shares, strict=True):
            seen = np.array([np.exp(-2j * np.pi * disparity * (v * q[0] + u * q[1])) for v, u in places])
            covariance += share * power * np.outer(seen, seen.conj())
            for n, slope in enumerate(slopes):
                wanted[n] += share * power * lens(weights, places, slope - disparity, q) * seen.conj()
    covariance += (known.unexplained * total + known.noise * known.mean_power) * np.eye(len(places))
    return np.linalg.solve(covariance.T, wanted.T).T


def of_views(factors, grid):
    """Complex factors of the views [N, V U, ...] from those of sums and differences of opposite ones."""
    n_first, _ = opposites(grid[0] * grid[1])
    sums, differences = factors[:, :n_first].numpy(), factors[:, n_first:].numpy()
    first = sums.astype(complex)
    first[:, : differences.shape[1]] += 1j * differences
    return np.concatenate([first, first[:, : differences.shape[1]][:, ::-1].conj()], 1)


def assert_least_squares(found, known, slopes, grid, aperture):
    made = of_views(found, grid)
    k_rows, k_columns = np.fft.fftfreq(SIDE), np.fft.rfftfreq(SIDE)
    for i, j in itertools.product(range(SIDE), range(SIDE // 2 + 1)):
        row, column = k_rows[i], k_columns[j]
        signs = (row, -row) if 2 * i == SIDE else (row,)
        expected = np.mean([by_least_squares(known, slopes, grid, aperture, (k, column)) for k in signs], 0)
        if i == j == 0:
            expected /= expected.sum(1, keepdims=True)
        # What is wanted is added up in single precision; solving enlarges its rounding by 1 / unexplained.
        np.testing.assert_allclose(made[:, :, i, j], expected, atol=2e-5)


def made(known, slopes, grid, aperture, reach=SIDE // 2, side=SIDE):
    return torch.stack(list(filters(known, slopes, grid, tuple(map(tuple, aperture.tolist())), reach, side)))


@pytest.mark.parametrize("grid", GRIDS)
def test_filters_are_the_estimate_of_least_squares(grid):
    aperture = batches.checked_weights(None, grid)
    assert_least_squares(made(KNOWN, SLOPES, grid, aperture), KNOWN, SLOPES, grid, aperture)


@pytest.mark.parametrize("grid", [(4, 5), (5, 5)])
def test_apertures_that_are_no_product_of_row_and_column(grid):
    aperture = batches.checked_weights(apertures.disc(grid), grid)
    assert int(torch.linalg.matrix_rank(aperture)) > 1
    assert_least_squares(made(KNOWN, SLOPES, grid, aperture), KNOWN, SLOPES, grid, aperture)


@pytest.mark.parametrize("grid", [(3, 3), (2, 4)])
def test_a_larger_square_has_the_same_filters(grid):
    reach, aperture = 4, batches.checked_weights(None, grid)
    small = impulses(made(KNOWN, SLOPES, grid, aperture, reach, 2 * reach), grid, 2 * reach)
    for side in (20, 30):
        wide = impulses(made(KNOWN, SLOPES, grid, aperture, reach, side), grid, side)
        # The outermost sample of the small square is both its first and its last one.
        inner = slice(side // 2 - reach + 1, side // 2 + reach)
        np.testing.assert_allclose(wide[..., inner, inner], small[..., 1:, 1:], atol=1e-6)
        within = slice(side // 2 - reach, side // 2 + reach + 1)
        wide[..., within, within] = 0
        assert np.abs(wide).max() < 1e-6


def impulses(factors, grid, side):
    """Filters of the views in pixels, their origin in the middle, [N, V U, side, side]."""
    spatial = np.fft.irfft2(of_views(factors, grid), s=(side, side))
    return np.roll(spatial, (side // 2, side // 2), (-2, -1))


@given(values=st.lists(st.floats(-4, 4), min_size=1, max_size=30))
@settings(max_examples=50, deadline=None)
def test_shares_are_probabilities_that_reach_a_margin_beyond_what_was_found(values):
    known = wiener_filters.prior_of_map(torch.tensor(values, dtype=torch.float64))
    assert sum(known.shares) == pytest.approx(1)
    assert min(known.shares) > 0
    assert known.disparities[0] <= min(values) - wiener_filters.MARGIN
    assert known.disparities[-1] >= max(values) + wiener_filters.MARGIN
    steps = torch.tensor(known.disparities, dtype=torch.float64).diff()
    torch.testing.assert_close(steps, torch.full_like(steps, wiener_filters.STEP))
