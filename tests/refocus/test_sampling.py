"""Interpolations and borders: weights, padding and spans against the definition; one record is all that one needs."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lfref.refocus import sampling
from lfref.refocus.sampling import BORDERS

NUMPY_MODES = {"renormalize": "edge", "edge": "edge", "zero": "constant", "wrap": "wrap"}


@pytest.mark.parametrize("name", list(BORDERS))
@pytest.mark.parametrize("axis", [-1, -2])
def test_extending_is_numpys_padding_along_that_axis_alone(name, axis):
    view = torch.rand(2, 3, 4, 5, 7)
    widths = [(0, 0)] * view.ndim
    widths[axis] = (3, 3)
    expected = np.pad(view.numpy(), widths, mode=NUMPY_MODES[name])
    np.testing.assert_array_equal(sampling.BORDERS[name].extend(view, 3, axis).numpy(), expected)


@given(length=st.integers(1, 30), share=st.floats(-1, 1))
def test_the_span_holds_exactly_the_samples_that_lie_on_the_view(length, share):
    # Multiples of 1/64, so that x + shift is exact.
    shift = round(share * length * 64) / 64
    counts = [float(0 <= x + shift <= length - 1) for x in range(length)]
    shifts = torch.tensor([[shift], [0.0]], dtype=torch.float64)
    found = sampling.is_sampled(shifts, torch.arange(length), length)
    assert found.double().tolist() == [counts, [1.0] * length]
    begin, end = BORDERS["renormalize"].span(shift, length)
    assert [float(begin <= x < end) for x in range(length)] == counts
    assert BORDERS["edge"].span(shift, length) == (0, length)
