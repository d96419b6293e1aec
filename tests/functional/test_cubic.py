"""Keys' weights against his kernel, piece by piece, for numbers and for tensors."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lfref.functional import splines


def keys(distance: float) -> float:
    distance = abs(distance)
    if distance < 1:
        return 1.5 * distance**3 - 2.5 * distance**2 + 1
    return -0.5 * distance**3 + 2.5 * distance**2 - 4 * distance + 2 if distance < 2 else 0.0


@given(t=st.floats(0, 1))
def test_weights_are_keys_kernel_at_the_distances_of_four_samples(t):
    expected = pytest.approx([keys(t + 1), keys(t), keys(1 - t), keys(2 - t)], abs=1e-14)
    assert list(splines.weights(t)) == expected
    assert torch.stack(splines.weights(torch.tensor(t, dtype=torch.float64))).tolist() == expected
