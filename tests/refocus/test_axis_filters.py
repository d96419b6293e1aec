"""Filters along an axis: those of brute-force least squares, and their taps."""

import pytest
import torch

from lfref import geometry
from lfref.refocus import axis_filters
from lfref.refocus.axis_filters import AxisSpectrum

SPECTRUM = AxisSpectrum(aliased=0.3, unexplained=0.01, noise=0.02)
SLOPES = torch.tensor([-1.3, 0.0, 0.4], dtype=torch.float64)
DISPARITIES = torch.tensor([-0.8, -0.7, 0.35], dtype=torch.float64)
SHARES = torch.tensor([0.2, 0.3, 0.5], dtype=torch.float64)
PERIOD = 32


def designed(n_views):
    """Filters [N, K, I] of one prior."""
    weights = torch.full((n_views,), 1 / n_views, dtype=torch.float64)
    table = axis_filters.tables(SPECTRUM, DISPARITIES, SLOPES, weights, PERIOD)
    return axis_filters.filters(SPECTRUM, table, SLOPES, SHARES[None], (SHARES @ DISPARITIES)[None])[0]


def complex_factors(filters):
    """Factor of each view, [..., K, I], of alphas, betas and the central factor."""
    n_pairs = filters.shape[-1] // 2
    alpha, beta, central = filters.split([n_pairs, n_pairs, filters.shape[-1] % 2], -1)
    one_side = torch.complex(alpha, beta)
    return torch.cat([one_side.conj().flip(-1), central + 0j, one_side], -1)


def brute_force(n_views, k, slope):
    """g of the module's equations at one frequency, complex, [I]."""
    offsets = geometry.angular_offsets(n_views)
    covariance, right = torch.zeros(n_views, n_views, dtype=torch.complex128), torch.zeros(n_views) + 0j
    mean, power_of_all = float(SHARES @ DISPARITIES), 0.0
    for m in (-1, 0, 1):
        q = torch.tensor(k + m, dtype=torch.float64)
        power = SPECTRUM.power(q)
        power_of_all += power
        for d, share in zip(DISPARITIES, SHARES, strict=True):
            seen = torch.exp(-2j * torch.pi * d * q * offsets)
            lens = (torch.cos(2 * torch.pi * (slope - d) * q * offsets).mean()) * torch.sinc((slope - d) * q)
            covariance += share * power * torch.outer(seen, seen.conj())
            right = right + share * power * lens * seen
    noise = SPECTRUM.unexplained * power_of_all + SPECTRUM.noise * SPECTRUM.mean_power / n_views
    covariance += noise * torch.eye(n_views)
    cell = torch.sinc(torch.tensor((slope - mean) * k))
    right = right + SPECTRUM.unexplained * power_of_all * cell / n_views * torch.exp(
        -2j * torch.pi * slope * k * offsets
    )
    # The estimate sum g L has the error E|T - g L|^2: conj(C) g = conj(b).
    return torch.linalg.solve(covariance.conj(), right.conj())


@pytest.mark.parametrize("n_views", [1, 2, 3, 4, 7])
def test_filters_are_those_of_complex_least_squares(n_views):
    found = complex_factors(designed(n_views))
    for number, slope in enumerate(SLOPES.tolist()):
        for j in (1, 5, 12):
            expected = brute_force(n_views, j / PERIOD, slope)
            torch.testing.assert_close(found[number, j], expected, atol=1e-9, rtol=1e-7)


@pytest.mark.parametrize(("n_views", "centres"), [(3, [-4, 0, 4]), (4, [-2, -1, 1, 2])])
def test_kernels_are_the_fourier_series_of_the_filters(n_views, centres):
    filters = designed(n_views)
    found = axis_filters.kernels(filters, torch.tensor(centres), 12)
    factors = complex_factors(filters)
    whole = torch.cat([factors, factors[:, 1:-1].flip(1).conj()], 1)  # of all frequencies of the period
    k = torch.fft.fftfreq(PERIOD, dtype=torch.float64)
    for view, centre in enumerate(centres):
        taps = centre + torch.arange(12) - 6
        waves = torch.exp(-2j * torch.pi * k[:, None] * taps)
        expected = (whole[:, :, view] @ waves).real / PERIOD
        torch.testing.assert_close(found[:, view], expected, atol=1e-12, rtol=0)
