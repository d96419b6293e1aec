"""The Fourier slice in plain NumPy makes the same picture as the operator that is timed beside it."""

import pytest
import torch

from lfref.bench.numpy_baselines import fourier_slice_numpy
from lfref.refocus.fourier.slice import fourier_slice


@pytest.mark.parametrize(("grid", "width", "padding"), [((7, 7), 4, 2), ((4, 5), 6, 2), ((1, 3), 3, 1.5)])
def test_it_equals_the_operator_except_at_frequency_0(grid, width, padding):
    views = torch.rand(*grid, 2, 21, 25, dtype=torch.float64)
    slopes = torch.tensor([-1.3, 0.2, 0.5, 1.0], dtype=torch.float64)
    stacks = (
        fourier_slice_numpy(views, slopes, width, padding),
        fourier_slice(views, slopes, width=width, padding=padding),
    )
    assert stacks[0].dtype == views.dtype
    spectra = [torch.fft.rfft2(stack, norm="ortho")[..., 1:, 1:] for stack in stacks]
    torch.testing.assert_close(*spectra, atol=1e-6, rtol=0)
