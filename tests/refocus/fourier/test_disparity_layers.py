"""Disparity layers: photographs of periodic layers, and refocusing that only corrects what cells do."""

import pytest
import torch

from lfref.errors import InputError
from lfref.refocus import apertures, batches
from lfref.refocus.focus.line_range import wide_range
from lfref.refocus.fourier.disparity_layers import disparity_layers, refocus_by_layers
from lfref.refocus.fourier.energies import SPACING, estimate_energies
from lfref.refocus.fourier.exact import exact_fourier
from tests.refocus.conftest import dirichlet, shifted_views, texture

DISPARITIES = [-1.0, 0.25, 1.0]
GRID = (5, 5)
OPTIONS = {"ridge": 1e-9, "border": "wrap"}


@pytest.fixture
def scene():
    """Textures of layers at `DISPARITIES`, and the views of their sum: no occlusion, periodic."""
    textures = [texture(1, 30, 33) for _ in DISPARITIES]
    return textures, sum(shifted_views(image, d, GRID) for image, d in zip(textures, DISPARITIES, strict=True))


def photograph(image, distance, n_views):
    """A periodic layer out of focus by `distance`, the integral over a square aperture, cell by fine cell."""
    cells = (torch.arange(200, dtype=torch.float64) + 0.5) / 200 - 0.5
    rows, columns = (
        torch.stack([dirichlet(length, distance * n * float(c)) for c in cells]).mean(0)
        for length, n in zip(image.shape[-2:], n_views, strict=True)
    )
    return rows @ image @ columns.T


def test_a_photograph_is_the_integral_over_the_aperture(scene):
    textures, views = scene
    stack = disparity_layers(views, DISPARITIES, **OPTIONS).refocus([0.25, -0.7])
    for made, slope in zip(stack, (0.25, -0.7), strict=True):
        expected = sum(photograph(image, slope - d, GRID) for image, d in zip(textures, DISPARITIES, strict=True))
        torch.testing.assert_close(made, expected, atol=2e-4, rtol=0)


def test_any_viewpoint_can_be_seen(scene):
    textures, views = scene
    layers = disparity_layers(views, DISPARITIES, **OPTIONS)
    torch.testing.assert_close(layers.view(0, 3), views[0, 3], atol=1e-5, rtol=0)
    between = sum(
        dirichlet(30, -d * (1.3 - 2)) @ image @ dirichlet(33, -d * (5.5 - 2)).T
        for image, d in zip(textures, DISPARITIES, strict=True)
    )
    torch.testing.assert_close(layers.view(1.3, 5.5), between, atol=1e-4, rtol=0)


@pytest.mark.parametrize(
    "options", [{"ridge": 0.0}, {"disparities": [9.0]}, {"disparities": []}, {"border": "?"}, {"n_layers": 0}]
)
def test_bad_arguments_are_refused(options):
    with pytest.raises(InputError):
        disparity_layers(torch.rand(*GRID, 1, 12, 13), **options)


SLOPES = [-2.0, -0.5, 0.0, 0.8]


def layered(*disparities):
    return sum(shifted_views(texture(3, 48, 60), d, GRID) for d in disparities) / len(disparities)


@pytest.mark.parametrize("weights", [None, apertures.disc((5, 5)), torch.arange(25.0).reshape(5, 5)])
def test_cells_without_area_are_exact_refocusing(weights):
    views = torch.rand(5, 5, 2, 20, 23, dtype=torch.float64)
    made = refocus_by_layers(views, SLOPES, fill_factor=0.0, weights=weights, border="wrap")
    torch.testing.assert_close(made, exact_fourier(views, SLOPES, weights), atol=1e-12, rtol=0)


def test_blur_has_no_copies():
    # Nine by nine views in each view's cell are the truth.
    image, slope, disparity = texture(1, 24, 26), -3.0, 0.2
    truth = exact_fourier(shifted_views(image, disparity / 9, (27, 27)), [slope / 9])
    views = shifted_views(image, disparity, (3, 3))
    points, areas = (
        (refocus_by_layers(views, [slope], [disparity], fill_factor=fill_factor, border="wrap") - truth).square().mean()
        for fill_factor in (0.0, 1.0)
    )
    assert areas < points / 50


def test_estimated_disparities_do_nearly_as_well_as_the_true_ones():
    views = layered(-1.0, 0.5)
    inner = (..., slice(8, -8), slice(8, -8))  # of views that are periodic
    truth = refocus_by_layers(views, SLOPES, [-1.0, 0.5], ridge=1e-6)[inner]
    estimated, points = (refocus_by_layers(views, SLOPES, fill_factor=each)[inner] for each in (1.0, 0.0))
    assert (estimated - truth).square().mean() < (points - truth).square().mean() / 30


FULL = batches.checked_weights(None, (5, 5))


@pytest.mark.parametrize("disparities", [(0.6,), (-1.25, 0.5), (-3.0, -1.0, 1.5)])
def test_finds_the_range_of_the_disparities(disparities):
    made = estimate_energies(layered(*disparities).mean(2), 9, FULL)
    assert made.disparities.shape == made.shares.shape == (9,)
    assert min(disparities) - 0.65 <= made.disparities[0] <= min(disparities)
    assert max(disparities) <= made.disparities[-1] <= max(disparities) + 0.65


def test_wide_ranges_are_found_and_their_layers_lie_close():
    views = shifted_views(texture(3, 96, 120), -2.1, (5, 5))
    views[..., 60:] = shifted_views(texture(3, 96, 120), 7.3, (5, 5))[..., 60:]
    made = estimate_energies(views.mean(2), 9, FULL, wide_range(views))
    assert -2.1 - 0.65 <= made.disparities[0] <= -2.1
    assert 7.3 <= made.disparities[-1] <= 7.3 + 0.65
    assert float(made.disparities.diff().max()) * 2 <= SPACING  # the outermost views are two steps away


@pytest.mark.parametrize("deviation", [0.01, 0.05])
def test_noise_is_what_layers_leave_at_quiet_frequencies(deviation):
    views = layered(-1.25, 0.5)
    noisy = views + deviation * torch.randn(views.shape, generator=torch.Generator().manual_seed(2))
    clean_noise, noise = (float(estimate_energies(field.mean(2), 9, FULL).noise) for field in (views, noisy))
    variance = deviation**2 / 3  # of the mean of three channels
    assert clean_noise < 0.1 * variance
    assert noise == pytest.approx(variance, rel=0.15)
