import numpy as np

from lfref.functional import row_sums


def test_taps_are_added_up_in_one_pass():
    rows, total = np.arange(40.0), np.ones(16)
    starts, weights = np.arange(row_sums.TAPS), np.linspace(1, 2, row_sums.TAPS)
    expected = sum(weight * rows[start : start + 16] for start, weight in zip(starts, weights, strict=True))
    row_sums.set_taps(rows, starts, weights, total)
    np.testing.assert_allclose(total, expected, rtol=1e-14)
    row_sums.add_taps(rows, starts, weights, total)
    np.testing.assert_allclose(total, 2 * expected, rtol=1e-14)
