"""Splines and cubic convolution through samples."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lfref.functional import splines
from tests.refocus.slow import keys


@pytest.mark.parametrize("size", [(21, 30), (9, 14), (2, 5), (7, 1), (1, 1)])
def test_coefficients_are_those_of_scipy(size):
    ndimage = pytest.importorskip("scipy.ndimage")
    image = np.random.default_rng(4).random(size).astype(np.float32)
    expected = ndimage.spline_filter(image.astype(np.float64), 3, mode="mirror")
    np.testing.assert_allclose(splines.coefficients(image[None])[0], expected, atol=5e-6)


@given(t=st.floats(0, 1))
def test_weights_are_keys_kernel_at_the_distances_of_four_samples(t):
    expected = pytest.approx([keys(t + 1), keys(t), keys(1 - t), keys(2 - t)], abs=1e-14)
    assert list(splines.weights(t)) == expected
    assert torch.stack(splines.weights(torch.tensor(t, dtype=torch.float64))).tolist() == expected
