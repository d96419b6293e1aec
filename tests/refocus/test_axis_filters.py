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


def designed(n_views, beside=None):
    """Filters [N, K, I] of one prior."""
    weights = torch.full((n_views,), 1 / n_views, dtype=torch.float64)
    table = axis_filters.tables(SPECTRUM, DISPARITIES, SLOPES, weights, PERIOD)
    return axis_filters.filters(SPECTRUM, table, SLOPES, SHARES[None], (SHARES @ DISPARITIES)[None], beside)[0]


def complex_factors(filters):
    """Factor of each view, [..., K, I], of alphas, betas and the central factor."""
    n_pairs = filters.shape[-1] // 2
    alpha, beta, central = filters.split([n_pairs, n_pairs, filters.shape[-1] % 2], -1)
    one_side = torch.complex(alpha, beta)
    return torch.cat([one_side.conj().flip(-1), central + 0j, one_side], -1)


def brute_force(n_views, k, slope, beside=1.0):
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
    white = SPECTRUM.noise * axis_filters.NOISE_GAIN * SPECTRUM.mean_power / n_views
    noise = SPECTRUM.unexplained * power_of_all + white * beside
    covariance += noise * torch.eye(n_views)
    cell = torch.sinc(torch.tensor((slope - mean) * k))
    right = right + SPECTRUM.unexplained * power_of_all * cell / n_views * torch.exp(
        -2j * torch.pi * slope * k * offsets
    )
    # The estimate sum g L has the error E|T - g L|^2: conj(C) g = conj(b).
    return torch.linalg.solve(covariance.conj(), right.conj())


@pytest.mark.parametrize("n_views", [1, 2, 3, 4, 7])
@pytest.mark.parametrize("is_blurred", [False, True])
def test_filters_are_those_of_complex_least_squares(n_views, is_blurred):
    # Noise of any share of each plane and frequency.
    beside = torch.linspace(0.1, 1, 3 * 17, dtype=torch.float64).reshape(3, 17) if is_blurred else None
    found = complex_factors(designed(n_views, beside))
    for number, slope in enumerate(SLOPES.tolist()):
        for j in (1, 5, 12):
            share = float(beside[number, j]) if is_blurred else 1.0
            expected = brute_force(n_views, j / PERIOD, slope, share)
            torch.testing.assert_close(found[number, j], expected, atol=1e-9, rtol=1e-7)


def test_a_lens_lets_less_noise_than_light_pass_where_it_blurs():
    weights = torch.full((5,), 0.2, dtype=torch.float64)
    found = axis_filters.noise_beside(DISPARITIES[2:], torch.ones(1).double(), torch.tensor([0.35, 1.35]), weights, 8)
    torch.testing.assert_close(found[0], torch.ones(5, dtype=torch.float64))
    # A box of 5 pixels at frequency 1/4: integrals of sin(5 pi y) / (5 sin(pi y)) times that of a cell, written out.
    y = (torch.arange(200_000, dtype=torch.float64) + 0.5) / 400_000
    lens = (torch.sin(5 * torch.pi * y) / (5 * torch.sin(torch.pi * y)) * torch.sinc(y)).square()
    power = (1 + (0.25**2 + y**2) / 0.01**2) ** -1.25 * torch.sinc(y) ** 2
    expected = lens.mean() / ((power * lens).sum() / power.sum())
    torch.testing.assert_close(found[1, 2], expected, rtol=1e-4, atol=0)


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
