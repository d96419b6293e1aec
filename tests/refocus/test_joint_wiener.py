"""The joint Wiener estimate: its filters by plain complex least squares; exact where the prior is, no seams."""

import itertools
import math

import numpy as np
import pytest
import torch
from torch.nn import functional as F

from lfref.refocus import apertures, batches
from lfref.refocus import joint_wiener as module
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.joint_wiener import Prior, filters, opposites


def doubles(*values):
    return torch.tensor(values, dtype=torch.float64)


KNOWN = Prior(doubles(-0.7, 0.1, 0.35), doubles(0.3, 0.5, 0.2), aliased=0.15, unexplained=0.02, noise=0.05)
SLOPES = (-1.2, 0.0, 0.3)
SIDE = 8


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
        for disparity, share in zip(known.disparities.tolist(), known.shares.tolist(), strict=True):
            seen = np.array([np.exp(-2j * np.pi * disparity * (v * q[0] + u * q[1])) for v, u in places])
            covariance += share * power * np.outer(seen, seen.conj())
            for n, slope in enumerate(slopes):
                wanted[n] += share * power * lens(weights, places, slope - disparity, q) * seen.conj()
    covariance += (known.unexplained * total + known.noise * float(known.mean_power)) * np.eye(len(places))
    return np.linalg.solve(covariance.T, wanted.T).T


def of_views(factors, grid):
    """Complex factors of the views [N, V U, ...] from those of sums and differences of opposite ones."""
    n_first, _ = opposites(grid[0] * grid[1])
    sums, differences = factors[:, :n_first].numpy(), factors[:, n_first:].numpy()
    first = sums.astype(complex)
    first[:, : differences.shape[1]] += 1j * differences
    return np.concatenate([first, first[:, : differences.shape[1]][:, ::-1].conj()], 1)


@pytest.mark.parametrize("weights", [apertures.full, apertures.disc])  # a disc is no product of row and column
@pytest.mark.parametrize("grid", [(3, 3), (2, 4), (5, 1), (5, 5), (1, 1)])
def test_filters_are_the_estimate_of_least_squares(grid, weights):
    aperture = batches.checked_weights(weights(grid), grid)
    made = of_views(torch.stack(list(filters(KNOWN, doubles(*SLOPES), grid, aperture, SIDE // 2, SIDE))), grid)
    k_rows, k_columns = np.fft.fftfreq(SIDE), np.fft.rfftfreq(SIDE)
    for i, j in itertools.product(range(SIDE), range(SIDE // 2 + 1)):
        row, column = k_rows[i], k_columns[j]
        signs = (row, -row) if 2 * i == SIDE else (row,)
        expected = np.mean([by_least_squares(KNOWN, SLOPES, grid, aperture, (k, column)) for k in signs], 0)
        if i == j == 0:
            expected /= expected.sum(1, keepdims=True)
        # What is wanted is added up in single precision; solving enlarges its rounding by 1 / unexplained.
        np.testing.assert_allclose(made[:, :, i, j], expected, atol=2e-5)


def only(disparity, unexplained=1e-4):
    """The prior of a scene that is one plane whose detail ends at half a cycle a pixel."""
    return Prior(doubles(disparity), doubles(1.0), aliased=0.0, unexplained=unexplained)


def waves(seed=0, n=30, highest=0.3):
    """Frequencies (ky, kx) in cycles per pixel [n, 2] and phases [n] of a texture."""
    generator = torch.Generator().manual_seed(seed)
    frequencies = highest * (2 * torch.rand(n, 2, dtype=torch.float64, generator=generator) - 1)
    return frequencies, 2 * math.pi * torch.rand(n, dtype=torch.float64, generator=generator)


def picture(shifts, size, blur=(0.0, 0.0)):
    """The texture moved by `shifts` [..., 2] down and right, under a box of `blur` pixels, [..., 1, H, W]."""
    frequencies, phases = waves()
    y, x = (torch.arange(length, dtype=torch.float64) for length in size)
    places = torch.stack(torch.meshgrid(y, x, indexing="ij"), -1) - shifts[..., None, None, :]
    box = torch.sinc(frequencies * torch.tensor(blur, dtype=torch.float64)).prod(-1)
    angle = 2 * math.pi * places @ frequencies.T + phases
    return 0.5 + (angle.cos() * box).mean(-1)[..., None, :, :]


def plane_views(disparity, grid, size):
    rows, columns = (torch.arange(n, dtype=torch.float64) - (n - 1) / 2 for n in grid)
    return picture(disparity * torch.stack(torch.meshgrid(rows, columns, indexing="ij"), -1), size)


def wiener(views, slope, prior):
    """The plane at a slope through all of the aperture."""
    aperture = batches.checked_weights(None, tuple(views.shape[:2]))
    return module.refocus_jointly(views, torch.tensor([slope], dtype=torch.float64), prior, aperture)[0]


def inner(images, margin):
    return images[..., margin:-margin, margin:-margin]


@pytest.mark.parametrize(("disparity", "grid"), [(-0.6, (5, 5)), (0.0, (2, 4)), (0.37, (1, 5))])
def test_a_plane_in_focus_is_its_texture(grid, disparity):
    views = plane_views(disparity, grid, (64, 66))
    made = wiener(views, disparity, only(disparity))
    expected = picture(torch.zeros(2, dtype=torch.float64), (64, 66))
    assert math.sqrt((made - expected)[..., 16:-16, 16:-16].square().mean()) < 2e-3


@pytest.mark.parametrize(("grid", "disparity", "slope"), [((5, 5), 0.2, -3.0), ((4, 3), -0.5, 1.0), ((5, 5), 0.0, 0.4)])
def test_what_is_out_of_focus_is_blurred_by_the_whole_aperture(grid, disparity, slope):
    views = plane_views(disparity, grid, (80, 82))
    made = wiener(views, slope, only(disparity))
    blur = tuple(n * (slope - disparity) for n in grid)
    expected = picture(torch.zeros(2, dtype=torch.float64), (80, 82), blur)
    error, points = (inner(x - expected, 24).square().mean() for x in (made, exact_fourier(views, [slope])[0]))
    assert float(error) < 1e-6
    assert error < points / 20


def test_folded_detail_is_told_apart_by_views_at_fractions_of_a_pixel():
    # A wave of .7 cycles a pixel, which one view takes for one of -.3.
    rows, columns = (torch.arange(5, dtype=torch.float64) - 2).expand(2, 5)
    x, disparity = torch.arange(80, dtype=torch.float64), 0.4
    wave = torch.cos(2 * math.pi * 0.7 * (x - disparity * columns[:, None]))
    views = wave[None, :, None, None, :].expand(len(rows), 5, 1, 60, 80)
    known = Prior(doubles(disparity), doubles(1.0), aliased=1.0, unexplained=1e-4)
    made = inner(wiener(views, disparity - 0.5, known), 20)
    # The photograph has the wave blurred by 5 x .5 pixels; samples of it are what is to be estimated.
    expected = (torch.sinc(torch.tensor(0.7 * 2.5)) * torch.cos(2 * math.pi * 0.7 * x))[20:-20]
    plain = inner(exact_fourier(views, [disparity - 0.5])[0], 20)
    assert (made - expected).square().mean() < (plain - expected).square().mean() / 4


MARGIN = 3


def kernels(n_planes, n_views):
    """Random filters [N, V U, 2 MARGIN + 1, ...]; those of opposite views mirror each other."""
    values = torch.randn(n_planes, n_views, 2 * MARGIN + 1, 2 * MARGIN + 1, dtype=torch.float64)
    return values + values.flip(1, 2, 3)


def factors(filters, side):
    """What `_filtered` takes, of filters in pixels."""
    n_sums, n_pairs = opposites(filters.shape[1])
    padding = side - filters.shape[-1]
    spectra = torch.fft.rfft2(F.pad(filters, (0, padding, 0, padding)).roll((-MARGIN, -MARGIN), (-2, -1)))
    return torch.cat([spectra[:, :n_sums].real, spectra[:, :n_pairs].imag], 1)


def convolved(views, filters):
    """Sums of the views' convolutions, beyond whose borders the outermost pixels go on."""
    n_fields, n_views, n_channels = views.shape[:3]
    padded = F.pad(views.flatten(0, 1), (MARGIN,) * 4, mode="replicate").unflatten(0, (n_fields, n_views))
    channels = padded.transpose(1, 2).flatten(0, 1)
    made = F.conv2d(channels, filters.flip(-2, -1))
    return made.unflatten(0, (n_fields, n_channels)).transpose(1, 2)


@pytest.mark.parametrize("side", [8, 12, 40])
@pytest.mark.parametrize(("grid", "size"), [((3, 3), (11, 17)), ((1, 4), (1, 23)), ((1, 1), (5, 4))])
def test_squares_of_any_side_make_the_convolution(side, grid, size):
    views = torch.randn(2, grid[0] * grid[1], 3, *size, dtype=torch.float64)
    taps = kernels(2, grid[0] * grid[1])
    made = module._filtered(views, factors(taps, side), side, MARGIN)
    assert made.shape == (2, 2, 3, *size)
    torch.testing.assert_close(made, convolved(views, taps), atol=1e-11, rtol=0)
