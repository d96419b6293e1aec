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


@given(t=st.floats(0, 1))
def test_cardinal_weights_keep_cubics_and_are_near_the_spline_itself(t):
    weights = splines.cardinal_weights(t)
    for power in range(4):
        assert sum(w * m**power for m, w in zip(splines.SAMPLES, weights, strict=True)) == pytest.approx(t**power)
    assert torch.stack(splines.cardinal_weights(torch.tensor(t, dtype=torch.float64))).tolist() == pytest.approx(
        weights
    )
    impulse = np.zeros((1, 41, 41), np.float32)
    impulse[0, 20] = 1
    coefficients = splines.coefficients(impulse)[0, :, 20].astype(np.float64)
    bumps = np.array([(1 - t) ** 3, 4 - 6 * t**2 + 3 * t**3, 4 - 6 * (1 - t) ** 2 + 3 * (1 - t) ** 3, t**3]) / 6
    spline = [bumps @ coefficients[20 - m - 1 : 20 - m + 3] for m in splines.SAMPLES]
    np.testing.assert_allclose(weights, spline, atol=3e-3)
