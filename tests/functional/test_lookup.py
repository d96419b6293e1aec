"""Look-ups of samples against NumPy's indexing, for any strides."""

import numpy as np
import pytest

from lfref.functional.lookup import look_up


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(
    "part", [np.s_[:], np.s_[..., :-1, :], np.s_[:, ::-1], np.s_[..., 0], np.s_[0, 0, 0, 0], np.s_[:0]], ids=str
)
def test_entries_are_those_of_plain_indexing(dtype, part):
    random = np.random.default_rng(0)
    table = random.random(np.iinfo(dtype).max + 1, np.float32)
    samples = random.integers(0, np.iinfo(dtype).max, (3, 2, 4, 5), dtype, endpoint=True)[part]
    found = look_up(table, samples)
    assert found.flags.c_contiguous
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, table[samples])


def test_transposed_samples_are_looked_up_in_their_order():
    samples = np.arange(24, dtype=np.uint8).reshape(2, 3, 4).transpose(2, 0, 1)
    np.testing.assert_array_equal(look_up(np.arange(256, dtype=np.float32), samples), samples)
