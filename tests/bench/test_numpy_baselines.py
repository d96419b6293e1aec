"""The Fourier slice in plain NumPy makes the picture of the operator that it is compared with."""

import pytest
import torch

from lfref.bench.numpy_baselines import fourier_slice_numpy
from lfref.refocus.fourier.slice import fourier_slice

SLOPES = [-1.3, 0.2, 0.5, 1.0]  # at whole ones the kernel ends on bins, of which NumPy's reads one


def assert_equal_off_bin_0(got, expected, atol):
    """Spectra are equal but at frequency 0, where the slice crosses bin 0 and the operator interpolates nothing."""
    spectra = [torch.fft.rfft2(stack.double(), norm="ortho")[..., 1:, 1:] for stack in (got, expected)]
    torch.testing.assert_close(*spectra, atol=atol, rtol=0)


@pytest.mark.parametrize("grid", [(7, 7), (4, 5), (1, 3)])
@pytest.mark.parametrize(("width", "padding"), [(4, 2), (6, 2), (3, 1.5)])
def test_it_equals_the_operator(grid, width, padding):
    views = torch.rand(*grid, 2, 21, 25, dtype=torch.float64)
    expected = fourier_slice(views, SLOPES, width=width, padding=padding)
    assert_equal_off_bin_0(fourier_slice_numpy(views, SLOPES, width, padding), expected, 1e-6)


def test_at_even_sizes_it_equals_the_operator_below_the_highest_frequency():
    views = torch.rand(5, 5, 3, 20, 24, dtype=torch.float64)
    for axis in (-1, -2):
        views = (views + views.roll(1, axis)) / 2
    assert_equal_off_bin_0(fourier_slice_numpy(views, SLOPES), fourier_slice(views, SLOPES), 3e-5)
    torch.testing.assert_close(fourier_slice_numpy(views, SLOPES), fourier_slice(views, SLOPES), atol=1e-3, rtol=0)


def test_it_keeps_the_type_of_the_views_and_takes_slopes_as_a_tensor():
    views = torch.rand(5, 5, 3, 21, 25)
    stack = fourier_slice_numpy(views, torch.tensor(SLOPES, dtype=torch.float64))
    assert (stack.shape, stack.dtype) == ((4, 3, 21, 25), torch.float32)
    assert_equal_off_bin_0(stack, fourier_slice(views, SLOPES), 1e-5)
