"""Exact refocusing in float32 and through cells; its filters against circular convolutions, summed up."""

import numpy as np
import pytest
import torch

from lfref import geometry
from lfref.refocus.fourier import exact
from lfref.refocus.fourier.exact import exact_fourier

SLOPES = [-1.3, 0.0, 0.37, 1.0]


def test_float32_phases_hold_at_full_size_and_large_slopes():
    views = torch.rand(1, 7, 1, 4, 540, dtype=torch.float64)
    slopes = geometry.slopes([0.125])
    assert (exact_fourier(views.float(), slopes).double() - exact_fourier(views, slopes)).abs().max() < 1e-6


def lens(image: torch.Tensor, width: float) -> torch.Tensor:
    """A periodic picture blurred by a box of some width along both axes, frequency by frequency."""
    rows, columns = (torch.fft.fftfreq(n, dtype=torch.float64) for n in image.shape[-2:])
    response = torch.sinc(width * rows)[:, None] * torch.sinc(width * columns)
    return torch.fft.ifft2(torch.fft.fft2(image) * response).real


@pytest.mark.parametrize("fill_factor", [0.5, 1.0])
@pytest.mark.parametrize("disparity", [0.0, -0.4])
def test_cells_of_all_the_aperture_are_the_integral_over_it(plane, fill_factor, disparity):
    views, image = plane(disparity)
    points = exact_fourier(views, SLOPES)
    filled = exact_fourier(views, SLOPES, fill_factor=fill_factor, disparity=disparity)
    for sum_of_points, stack, slope in zip(points, filled, SLOPES, strict=True):
        width = slope - disparity
        torch.testing.assert_close(stack, lens(sum_of_points, fill_factor * width), atol=1e-12, rtol=0)
        if fill_factor == 1:
            torch.testing.assert_close(stack, lens(image, 7 * width), atol=1e-12, rtol=0)


def slow_filter_and_sum(views, rows, columns, weights):
    """Circular convolutions by rolling the views about; rows [N, V, H] and columns [N, U, W] are real filters."""
    stack = np.zeros((len(views), len(rows), *views.shape[3:]))
    for n, v, u in np.ndindex(len(rows), *weights.shape):
        view = weights[v, u] * views[:, v, u]
        across = sum(tap * np.roll(view, x, -1) for x, tap in enumerate(columns[n, u]))
        stack[:, n] += sum(tap * np.roll(across, y, -2) for y, tap in enumerate(rows[n, v]))
    return stack


def filters(grid, size, n_planes=2):
    """Random real filters, and the factors that they are at the frequencies."""
    rows = torch.randn(n_planes, grid[0], size[0], dtype=torch.float64)
    columns = torch.randn(n_planes, grid[1], size[1], dtype=torch.float64)
    factors = (torch.view_as_real(part).movedim(-1, 0) for part in (torch.fft.fft(rows), torch.fft.rfft(columns)))
    return (rows.numpy(), columns.numpy()), tuple(factors)


@pytest.mark.parametrize("size", [(6, 8), (5, 7), (6, 5), (1, 4), (2, 1)])
@pytest.mark.parametrize("grid", [(3, 2), (1, 4)])
def test_equals_the_slow_reference(size, grid):
    views = torch.rand(2, *grid, 2, *size, dtype=torch.float64)
    weights = torch.rand(grid, dtype=torch.float64)
    taps, factors = filters(grid, size)
    stack = exact.filter_and_sum(views, *factors, weights)
    expected = slow_filter_and_sum(views.numpy(), *taps, weights.numpy())
    np.testing.assert_allclose(stack.numpy(), expected, atol=1e-12)
