"""Beyond the edge: each rule against numpy's padding, and the span of samples against the definition."""

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
@pytest.mark.parametrize("batch", [(), (2,), (2, 3, 4)])
def test_extending_is_numpys_padding_along_that_axis_alone(name, axis, batch):
    view = torch.rand(*batch, 5, 7)
    widths = [(0, 0)] * view.ndim
    widths[axis] = (3, 3)
    expected = np.pad(view.numpy(), widths, mode=NUMPY_MODES[name])
    np.testing.assert_array_equal(sampling.BORDERS[name].extend(view, 3, axis).numpy(), expected)


@pytest.mark.parametrize("name", list(BORDERS))
def test_extending_by_nothing_changes_nothing(name):
    view = torch.rand(2, 4, 5)
    assert torch.equal(BORDERS[name].extend(view, 0, -1), view)


def test_only_renormalize_leaves_samples_out_and_only_wrap_is_periodic():
    assert [name for name, border in BORDERS.items() if border.counts_only_samples] == ["renormalize"]
    assert [name for name, border in BORDERS.items() if border.is_periodic] == ["wrap"]


@pytest.mark.parametrize(
    ("shift", "span"),
    [(0.0, (0, 8)), (2.0, (0, 6)), (-2.0, (2, 8)), (0.5, (0, 7)), (-0.5, (1, 8)), (1.25, (0, 6)), (-1.25, (2, 8))],
)
def test_the_span_by_hand(shift, span):
    assert sampling.sampled_span(shift, 8) == span


@given(length=st.integers(1, 30), share=st.floats(-1, 1))
def test_the_span_holds_exactly_the_samples_that_lie_on_the_view(length, share):
    # Multiples of 1/64, so that x + shift is exact.
    shift = round(share * length * 64) / 64
    mask = sampling.sampled([shift], length)[0]
    assert mask.tolist() == [float(0 <= x + shift <= length - 1) for x in range(length)]


def test_masks_stand_in_the_order_of_the_shifts():
    mask = sampling.sampled([1.0, -2.0, 0.0], 4)
    assert mask.tolist() == [[1, 1, 1, 0], [0, 0, 1, 1], [1, 1, 1, 1]]
    assert mask.dtype == torch.float64
