"""The Wiener estimate: exact where the prior is, the blur of a lens out of focus, no seams."""

import math

import pytest
import torch
from torch.nn import functional as F

from lfref.refocus import batches
from lfref.refocus import wiener as module
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.wiener_filters import Prior, opposites


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
    known = Prior((disparity,), (1.0,), aliased=1.0, unexplained=1e-4)
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
    filters = kernels(2, grid[0] * grid[1])
    made = module._filtered(views, factors(filters, side), side, MARGIN)
    assert made.shape == (2, 2, 3, *size)
    torch.testing.assert_close(made, convolved(views, filters), atol=1e-11, rtol=0)
