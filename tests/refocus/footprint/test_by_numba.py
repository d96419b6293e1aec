"""The compiled loops against PyTorch's operations, which are tested against the definition in `test_by_torch`."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.refocus import footprint_blur
from lfref.refocus.footprint_blur import RowFactors
from lfref.refocus.sampling import BORDERS


def boxed(stack, widths, border, factors=None):
    height, width = stack.shape[-2:]
    kinds = np.arange(height)
    ones = np.ones((height, width), stack.numpy().dtype)
    scales = [RowFactors(ones if factors is None else factors, kinds) for _ in widths]
    blurred = stack.clone()
    footprint_blur.box_planes(blurred.numpy(), widths, BORDERS[border], scales)
    return blurred


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("border", list(BORDERS))
def test_equals_eager(border, dtype):
    stack, widths = torch.rand(2, 4, 2, 19, 33, dtype=torch.float64).to(dtype), [0.0, 0.7, 3.2, 21.5]
    expected = [footprint_blur.boxed(stack[:, n], width, BORDERS[border]) for n, width in enumerate(widths)]
    tolerance = 1e-6 if dtype == torch.float32 else 1e-12
    torch.testing.assert_close(boxed(stack, widths, border), torch.stack(expected, dim=1), atol=tolerance, rtol=0)


@settings(deadline=None, max_examples=40)
@given(
    height=st.integers(1, 20),
    width=st.integers(1, 40),
    box=st.floats(0, 25),
    border=st.sampled_from(list(BORDERS)),
)
def test_equals_eager_at_any_size(height, width, box, border):
    stack = torch.rand(1, 1, 1, height, width, dtype=torch.float64)
    expected = footprint_blur.boxed(stack, box, BORDERS[border])
    torch.testing.assert_close(boxed(stack, [box], border), expected, atol=1e-12, rtol=0)


def test_rows_are_multiplied_by_their_factors_after_the_blur():
    stack, factors = torch.rand(1, 1, 1, 6, 8, dtype=torch.float64), torch.rand(6, 8, dtype=torch.float64)
    expected = factors * footprint_blur.boxed(stack, 2.0, BORDERS["edge"])
    torch.testing.assert_close(boxed(stack, [2.0], "edge", factors.numpy()), expected, atol=1e-12, rtol=0)


@pytest.mark.parametrize("n_maps", [1, 2])
@pytest.mark.parametrize("border", list(BORDERS))
def test_maps_equal_eager(border, n_maps):
    stack = torch.rand(2, 3, 2, 19, 33, dtype=torch.float64)
    places = 6 * torch.rand(n_maps, 3, 19, 33, dtype=torch.float64)
    places[:, 1] = 0
    expected = [footprint_blur.blended(stack[:, n], places[:, n], BORDERS[border]) for n in range(3)]
    blended = footprint_blur.blurred_numba(stack, places, BORDERS[border], None)
    torch.testing.assert_close(blended, torch.stack(expected, dim=1), atol=1e-12, rtol=0)


@pytest.mark.parametrize("n_threads", [1, 2, 5])
def test_the_number_of_threads_changes_nothing(n_threads, monkeypatch):
    monkeypatch.setattr(footprint_blur, "WORTH_A_THREAD", 1)
    stack, places = torch.rand(2, 3, 2, 9, 13), 4 * torch.rand(1, 3, 9, 13)
    alone = boxed(stack, [1.0, 2.0, 3.0], "edge"), footprint_blur.blurred_numba(stack, places, BORDERS["edge"], None)
    monkeypatch.setattr(torch, "get_num_threads", lambda: n_threads)
    assert torch.equal(boxed(stack, [1.0, 2.0, 3.0], "edge"), alone[0])
    assert torch.equal(footprint_blur.blurred_numba(stack, places, BORDERS["edge"], None), alone[1])
