"""Squares that overlap make the same picture as one convolution of the views, whatever their side."""

import pytest
import torch
from torch.nn import functional as F

from lfref.refocus import wiener
from lfref.refocus.wiener_filters import opposites

MARGIN = 3


def kernels(n_planes, n_views):
    """Random filters [N, V U, 2 MARGIN + 1, ...]; those of opposite views mirror each other."""
    values = torch.randn(n_planes, n_views, 2 * MARGIN + 1, 2 * MARGIN + 1, dtype=torch.float64)
    return values + values.flip(1, 2, 3)


def factors(filters, grid, side):
    """What `filtered` takes, of filters in pixels."""
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


@pytest.mark.parametrize("side", [8, 10, 12, 20, 40])
@pytest.mark.parametrize(("grid", "size"), [((3, 3), (11, 17)), ((2, 2), (12, 9)), ((1, 4), (1, 23)), ((1, 1), (5, 4))])
def test_squares_of_any_side_make_the_convolution(side, grid, size):
    views = torch.randn(2, grid[0] * grid[1], 3, *size, dtype=torch.float64)
    filters = kernels(2, grid[0] * grid[1])
    made = wiener._filtered(views, opposites(grid), factors(filters, grid, side), MARGIN)
    assert made.shape == (2, 2, 3, *size)
    torch.testing.assert_close(made, convolved(views, filters), atol=1e-11, rtol=0)


def test_gradients_pass_the_seams():
    views = torch.randn(1, 4, 1, 5, 6, dtype=torch.float64, requires_grad=True)
    spectra = factors(kernels(1, 4), (2, 2), 8)
    assert torch.autograd.gradcheck(lambda x: wiener._filtered(x, opposites((2, 2)), spectra, MARGIN), views)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("side", [8, 40])
def test_the_loop_adds_up_what_pytorch_does(side, dtype):
    spectra = torch.randn(9, 4, side, side // 2 + 1, dtype=dtype) * (1 + 2j)
    weights = torch.randn(2, 9, side, side // 2 + 1, dtype=dtype)
    by_loop, by_torch = (add(spectra, weights, 5) for add in (wiener._by_loop, wiener._by_torch))
    assert by_loop.dtype == by_torch.dtype == spectra.dtype
    torch.testing.assert_close(by_loop, by_torch)


@pytest.mark.parametrize("add", [wiener._by_loop, wiener._by_torch])
def test_factors_of_differences_are_times_i(add):
    spectra, weights = torch.randn(5, 3, 8, 5) * (1 + 1j), torch.randn(2, 5, 8, 5)
    turns = torch.tensor([1, 1, 1, 1j, 1j])
    expected = torch.einsum("p,npyx,pjyx->njyx", turns, weights + 0j, spectra)
    torch.testing.assert_close(add(spectra, weights, 3), expected)
