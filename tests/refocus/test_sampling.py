"""Interpolations and borders: weights, padding and spans against the definition; one record is all that one needs."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lfref.refocus import sampling
from lfref.refocus.sampling import BORDERS, INTERPOLATIONS, Border, Interpolation
from lfref.refocus.shift.shift_and_sum import coverage, shift_and_sum
from lfref.refocus.surface import per_pixel

LOCAL = [name for name, way in INTERPOLATIONS.items() if way.weights is not None]
SLOPES = [-1.4, 0.0, 0.37, 1.0]
NUMPY_MODES = {"renormalize": "edge", "edge": "edge", "zero": "constant", "wrap": "wrap"}


@pytest.mark.parametrize(
    ("position", "snapped"), [(0.49, 0), (0.5, 1), (-0.5, 0), (-0.51, -1), (1.5, 2), (-1.5, -1), (2.0, 2), (-2.0, -2)]
)
def test_only_nearest_rounds_and_halves_upwards(position, snapped):
    assert INTERPOLATIONS["nearest"].snap(position) == snapped
    assert all(INTERPOLATIONS[name].snap(position) == position for name in ("linear", "cubic", "exact"))


def on_flat_maps(views, *choice):
    return per_pixel(
        views, torch.tensor(SLOPES, dtype=torch.float64)[:, None, None].expand(-1, *views.shape[-2:]), *choice
    )


def test_an_entry_is_all_that_a_new_interpolation_needs(monkeypatch):
    # Each sample a plateau with a smooth step to the next.
    smooth = Interpolation(lambda t: (1 - t**2 * (3 - 2 * t), t**2 * (3 - 2 * t)))
    monkeypatch.setitem(INTERPOLATIONS, "smooth", smooth)
    views = torch.rand(3, 4, 2, 11, 12, dtype=torch.float64)
    for border in BORDERS:
        expected = shift_and_sum(views, SLOPES, "smooth", border)
        by_torch = shift_and_sum(views.clone().requires_grad_(), SLOPES, "smooth", border)
        torch.testing.assert_close(by_torch.detach(), expected, atol=1e-13, rtol=0)
        torch.testing.assert_close(on_flat_maps(views, "smooth", border), expected, atol=1e-12, rtol=0)
    by_hand = 0.5 * views[0, 0] + 0.5 * views[0, 0].roll(-1, -1)
    halfway = shift_and_sum(views[:1, :1].expand(1, 2, -1, -1, -1), [1.0], "smooth", "wrap", torch.tensor([[0, 1.0]]))
    torch.testing.assert_close(halfway[0], by_hand, atol=1e-13, rtol=0)
    assert torch.equal(coverage(SLOPES, (3, 4), (11, 12), "smooth"), coverage(SLOPES, (3, 4), (11, 12)))


def test_an_entry_is_all_that_a_new_border_needs(monkeypatch):
    def mirrored(index, weight, length):
        period = index.remainder(2 * length - 2)
        return torch.minimum(period, 2 * length - 2 - period), weight

    monkeypatch.setitem(BORDERS, "mirror", Border("reflect", mirrored))
    views = torch.rand(3, 4, 2, 11, 12, dtype=torch.float64)
    far = sampling.BORDERS["mirror"].extend(views, 5, -1)
    assert torch.equal(far[..., 4], views[..., 1])
    for interpolation in LOCAL:
        expected = shift_and_sum(views, SLOPES, interpolation, "mirror")
        torch.testing.assert_close(on_flat_maps(views, interpolation, "mirror"), expected, atol=1e-12, rtol=0)
        assert (expected - shift_and_sum(views, SLOPES, interpolation, "edge")).abs().max() > 0.01


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
    assert sampling.sampled([shift, 0.0], length).tolist() == [counts, [1.0] * length]
    begin, end = sampling.sampled_span(shift, length)
    assert [float(begin <= x < end) for x in range(length)] == counts


def test_taps_are_added_up_in_one_pass():
    rows, total = np.arange(40.0), np.ones(16)
    starts, weights = np.arange(sampling.TAPS), np.linspace(1, 2, sampling.TAPS)
    expected = sum(weight * rows[start : start + 16] for start, weight in zip(starts, weights, strict=True))
    sampling.set_taps(rows, starts, weights, total)
    np.testing.assert_allclose(total, expected, rtol=1e-14)
    sampling.add_taps(rows, starts, weights, total)
    np.testing.assert_allclose(total, 2 * expected, rtol=1e-14)
