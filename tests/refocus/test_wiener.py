"""The Wiener estimate: exact where the prior is, the blur of a lens out of focus, no seams."""

import math

import pytest
import torch
from torch.nn import functional as F

from lfref.refocus import wiener as module
from lfref.refocus.disparity.disparity_map import coarse_disparity
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.wiener import wiener
from lfref.refocus.wiener_filters import Prior, opposites, prior_between, prior_of_map

SLOPES = [-2.0, -0.4, 0.3]
KNOWN = prior_between(-1.0, 0.5)


def only(disparity, unexplained=1e-4):
    """The prior of a scene that is one plane whose detail ends at half a cycle a pixel."""
    return Prior((disparity,), (1.0,), aliased=0.0, unexplained=unexplained)


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


def inner(images, margin):
    return images[..., margin:-margin, margin:-margin]


@pytest.mark.parametrize(("disparity", "grid"), [(-0.6, (5, 5)), (0.0, (2, 4)), (0.37, (1, 5))])
def test_a_plane_in_focus_is_its_texture(grid, disparity):
    views = plane_views(disparity, grid, (64, 66))
    made = wiener(views, [disparity], only(disparity))[0]
    expected = picture(torch.zeros(2, dtype=torch.float64), (64, 66))
    assert math.sqrt((made - expected)[..., 16:-16, 16:-16].square().mean()) < 2e-3


@pytest.mark.parametrize(("grid", "disparity", "slope"), [((5, 5), 0.2, -3.0), ((4, 3), -0.5, 1.0), ((5, 5), 0.0, 0.4)])
def test_what_is_out_of_focus_is_blurred_by_the_whole_aperture(grid, disparity, slope):
    views = plane_views(disparity, grid, (80, 82))
    made = wiener(views, [slope], only(disparity))[0]
    blur = tuple(n * (slope - disparity) for n in grid)
    expected = picture(torch.zeros(2, dtype=torch.float64), (80, 82), blur)
    error, points = (inner(x - expected, 24).square().mean() for x in (made, exact_fourier(views, [slope])[0]))
    assert float(error) < 1e-6
    assert error < points / 20


def test_without_a_prior_each_light_field_has_the_disparities_of_its_own_map():
    fields = torch.stack([plane_views(disparity, (3, 3), (48, 50)) for disparity in (-0.5, 0.4)]).float()
    stacks = wiener(fields, SLOPES)
    for field, stack in zip(fields, stacks, strict=True):
        torch.testing.assert_close(stack, wiener(field, SLOPES, prior_of_map(coarse_disparity(field))))
    # The disparities of the other light field give another picture.
    other = wiener(fields[0], SLOPES, prior_of_map(coarse_disparity(fields[1])))
    assert float((stacks[0] - other).abs().max()) > 1e-3


def test_planes_at_the_border_are_no_farther_off_than_the_views_reach():
    views = plane_views(0.2, (5, 5), (64, 66))
    made = wiener(views, [0.2], only(0.2))[0]
    error = (made - picture(torch.zeros(2, dtype=torch.float64), (64, 66))).abs()
    assert float(error[:, 8:-8, 8:-8].max()) < 0.02
    assert float(error.max()) < 0.3


def test_noise_that_views_do_not_share_is_averaged_away():
    noise = torch.randn(5, 5, 1, 64, 64, dtype=torch.float64)
    quiet, loud = (wiener(noise, [0.2], only(0.2, unexplained)).std() for unexplained in (10.0, 1e-4))
    assert quiet <= loud
    assert loud < 1.2 / 5


def test_folded_detail_is_told_apart_by_views_at_fractions_of_a_pixel():
    # A wave of .7 cycles a pixel, which one view takes for one of -.3.
    rows, columns = (torch.arange(5, dtype=torch.float64) - 2).expand(2, 5)
    x, disparity = torch.arange(80, dtype=torch.float64), 0.4
    wave = torch.cos(2 * math.pi * 0.7 * (x - disparity * columns[:, None]))
    views = wave[None, :, None, None, :].expand(len(rows), 5, 1, 60, 80)
    known = Prior((disparity,), (1.0,), aliased=1.0, unexplained=1e-4)
    made = inner(wiener(views, [disparity - 0.5], known)[0], 20)
    # The photograph has the wave blurred by 5 x .5 pixels; samples of it are what is to be estimated.
    expected = (torch.sinc(torch.tensor(0.7 * 2.5)) * torch.cos(2 * math.pi * 0.7 * x))[20:-20]
    plain = inner(exact_fourier(views, [disparity - 0.5])[0], 20)
    assert (made - expected).square().mean() < (plain - expected).square().mean() / 4


def test_a_photograph_through_one_view_is_that_view():
    aperture = torch.zeros(3, 3)
    aperture[1, 1] = 1
    views = plane_views(0.3, (3, 3), (64, 64))
    made = wiener(views, [0.3], only(0.3), aperture)[0]
    assert math.sqrt((made - views[1, 1])[..., 16:-16, 16:-16].square().mean()) < 2e-3


MARGIN = 3


def kernels(n_planes, n_views):
    """Random filters [N, V U, 2 MARGIN + 1, ...]; those of opposite views mirror each other."""
    values = torch.randn(n_planes, n_views, 2 * MARGIN + 1, 2 * MARGIN + 1, dtype=torch.float64)
    return values + values.flip(1, 2, 3)


def factors(filters, grid, side):
    """What `_filtered` takes, of filters in pixels."""
    both = opposites(grid)
    padding = side - filters.shape[-1]
    spectra = torch.fft.rfft2(F.pad(filters, (0, padding, 0, padding)).roll((-MARGIN, -MARGIN), (-2, -1)))
    return torch.cat([spectra[:, : len(both.first)].real, spectra[:, : both.n_pairs].imag], 1)


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
    filters = kernels(2, grid[0] * grid[1])
    made = module._filtered(views, opposites(grid), factors(filters, grid, side), side, MARGIN, by_loop=False)
    assert made.shape == (2, 2, 3, *size)
    torch.testing.assert_close(made, convolved(views, filters), atol=1e-11, rtol=0)


@pytest.mark.parametrize("add", [module._by_loop, module._by_torch])
def test_factors_of_differences_are_times_i(add):
    spectra, weights = torch.randn(5, 3, 8, 5) * (1 + 1j), torch.randn(2, 5, 8, 5)
    turns = torch.tensor([1, 1, 1, 1j, 1j])
    expected = torch.einsum("p,npyx,pjyx->njyx", turns, weights + 0j, spectra)
    table = torch.stack(list(map(module._lanes, weights))) if add is module._by_loop else weights
    torch.testing.assert_close(add(spectra, table, 3), expected)


@pytest.mark.parametrize("n_at_once", [1, 2**20])
@pytest.mark.parametrize("grid", [(3, 3), (1, 4), (1, 1)])
def test_spectra_are_those_of_views_mixed_with_their_opposites(monkeypatch, n_at_once, grid):
    monkeypatch.setattr(module, "MIXED_AT_ONCE", n_at_once)
    both, views = opposites(grid), torch.rand(2, grid[0] * grid[1], 3, 9, 30)
    first = module._spectra(views, both, (-2, -3), 2, 8, 4)
    padded = F.pad(views.flatten(0, 1), (3, 0, 2, 0), mode="replicate").unflatten(0, views.shape[:2])
    expected = torch.fft.rfft2(torch.stack([padded[..., :8, x : x + 8] for x in (0, 4)], 3)).transpose(0, 1)
    n_sums = len(both.first)
    for p in range(both.n_pairs):
        torch.testing.assert_close(first[p], expected[p] + expected[-1 - p])
        torch.testing.assert_close(first[n_sums + p], expected[p] - expected[-1 - p])
    if len(expected) % 2:
        torch.testing.assert_close(first[both.n_pairs], expected[both.n_pairs])
