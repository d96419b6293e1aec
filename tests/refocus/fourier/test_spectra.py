"""A view times a factor for its row and its column is its circular convolution with two filters, here summed up."""

import numpy as np
import pytest
import torch

from lfref.refocus import batches
from lfref.refocus.fourier import exact


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
    return (rows.numpy(), columns.numpy()), (torch.fft.fft(rows), torch.fft.rfft(columns))


@pytest.mark.parametrize("size", [(6, 8), (5, 7), (6, 5), (1, 4), (2, 1)])
@pytest.mark.parametrize("grid", [(3, 2), (1, 4)])
@pytest.mark.parametrize("batch", [1, 2])
def test_equals_the_slow_reference(size, grid, batch):
    views = torch.rand(batch, *grid, 2, *size, dtype=torch.float64)
    weights = torch.rand(grid, dtype=torch.float64)
    taps, factors = filters(grid, size)
    stack = exact.filter_and_sum(views, *factors, weights)
    expected = slow_filter_and_sum(views.numpy(), *taps, weights.numpy())
    np.testing.assert_allclose(stack.numpy(), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("dtype", "working"),
    [(torch.float16, torch.float32), (torch.float32, torch.float32), (torch.float64, torch.float64)],
)
def test_half_precision_is_computed_in_float32(dtype, working):
    views, weights = torch.rand(1, 2, 3, 1, 6, 7).to(dtype), torch.rand(2, 3, dtype=torch.float64)
    _, factors = filters((2, 3), (6, 7))
    stack = exact.filter_and_sum(views, *factors, weights)
    assert stack.dtype == working
    expected = exact.filter_and_sum(views.double(), *factors, weights)
    torch.testing.assert_close(stack.double(), expected, atol=1e-4, rtol=1e-5)


@pytest.mark.parametrize("dtype", list(batches.FULL_SCALE))
def test_integers_are_scaled_to_radiance(dtype):
    views = torch.randint(0, 256, (1, 2, 3, 1, 6, 7)).to(dtype)
    weights = torch.rand(2, 3, dtype=torch.float64)
    _, factors = filters((2, 3), (6, 7))
    expected = exact.filter_and_sum(batches.radiance(views), *factors, weights)
    assert torch.equal(exact.filter_and_sum(views, *factors, weights), expected)


def test_a_view_of_weight_0_does_not_count():
    views, weights = torch.rand(1, 2, 2, 1, 5, 6), torch.tensor([[0.0, 1.0], [2.0, 0.0]])
    other = views.clone()
    other[:, 0, 0] = other[:, 1, 1] = 7
    _, factors = filters((2, 2), (5, 6))
    assert torch.equal(exact.filter_and_sum(views, *factors, weights), exact.filter_and_sum(other, *factors, weights))
