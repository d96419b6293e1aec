"""Interpolations: their weights, and that an entry in the table is all that a new one, or a new border, needs."""

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


@given(position=st.floats(-50, 50))
@pytest.mark.parametrize("name", LOCAL)
def test_weights_sum_to_1_about_the_position(name, position):
    way = INTERPOLATIONS[name]
    taps = way.taps(way.snap(position))
    assert sum(weight for _, weight in taps) == pytest.approx(1, abs=1e-12)
    assert sum(index * weight for index, weight in taps) == pytest.approx(way.snap(position), abs=1e-9)


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
