"""The loop as it stands, without a compiler, and compiled: sums of spectra times factors, a band of rows at a time."""

import numpy as np
import pytest

from lfref.refocus.wiener import LANES, add_rows


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize(("n_given", "n_sums", "width"), [(9, 5, 21), (4, 2, LANES), (1, 1, 3)])
def test_only_the_rows_of_the_band_are_written(compiled, n_given, n_sums, width):
    generator = np.random.default_rng(0)
    n_planes, n_pictures, height = 2, 3, 4
    spectra = generator.standard_normal((n_given, n_pictures, height, width, 2))
    n_lanes = -(-width // LANES)
    factors = generator.standard_normal((n_planes, height, n_lanes, n_given, LANES))
    made = np.full((n_planes, n_pictures, height, width, 2), np.nan)
    (add_rows if compiled else add_rows.py_func)(spectra, factors, n_sums, 1, 3, made)
    turned = spectra.view(np.complex128)[..., 0] * np.where(np.arange(n_given) < n_sums, 1, 1j)[:, None, None, None]
    of_frequencies = factors.transpose(0, 3, 1, 2, 4).reshape(n_planes, n_given, height, -1)[..., :width]
    expected = np.einsum("npyx,pjyx->njyx", of_frequencies, turned)
    np.testing.assert_allclose(made[:, :, 1:3].view(np.complex128)[..., 0], expected[:, :, 1:3], atol=1e-12)
    assert np.isnan(made[:, :, [0, 3]]).all()
