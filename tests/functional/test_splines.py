"""Splines go through their samples, and are those of SciPy."""

import numpy as np
import pytest

from lfref.functional import splines


@pytest.mark.parametrize("size", [(9, 14), (2, 5), (7, 1), (1, 1), (40, 33)])
def test_coefficients_make_the_samples_again(size):
    images = np.random.default_rng(3).random((2, *size)).astype(np.float32)
    made = splines.coefficients(images)
    for axis, length in ((1, size[0]), (2, size[1])):
        if length > 1:
            before = np.concatenate([made.take([1], axis), made.take(range(length - 1), axis)], axis)
            after = np.concatenate([made.take(range(1, length), axis), made.take([length - 2], axis)], axis)
            made = (before + 4 * made + after) / 6
    np.testing.assert_allclose(made, images, atol=2e-6)


def test_coefficients_are_those_of_scipy():
    ndimage = pytest.importorskip("scipy.ndimage")
    image = np.random.default_rng(4).random((21, 30)).astype(np.float32)
    expected = ndimage.spline_filter(image.astype(np.float64), 3, mode="mirror")
    np.testing.assert_allclose(splines.coefficients(image[None])[0], expected, atol=5e-6)


def test_samples_are_left_as_they_were():
    images = np.ones((1, 8, 8), np.float32)
    splines.coefficients(images)[:] = 0
    assert (images == 1).all()
