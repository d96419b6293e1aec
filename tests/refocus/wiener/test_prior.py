"""What is thought of a scene: shares that are a histogram with doubt, power that fades, beyond half a cycle steeply."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.errors import InputError
from lfref.refocus import wiener_filters
from lfref.refocus.wiener_filters import Prior


def share_near(known, disparity, radius=1.5 * wiener_filters.STEP):
    near = zip(known.disparities, known.shares, strict=True)
    return sum(share for each, share in near if abs(each - disparity) < radius)


@given(
    values=st.lists(st.floats(-4, 4), min_size=1, max_size=30),
    confidence=st.floats(0.1, 1.0),
)
@settings(max_examples=50, deadline=None)
def test_shares_are_probabilities_that_reach_a_margin_beyond_what_was_found(values, confidence):
    disparity = torch.tensor(values, dtype=torch.float64)
    known = wiener_filters.prior_of_map(disparity, torch.full_like(disparity, confidence))
    assert sum(known.shares) == pytest.approx(1)
    assert min(known.shares) > 0
    assert known.disparities[0] <= min(values) - wiener_filters.MARGIN
    assert known.disparities[-1] >= max(values) + wiener_filters.MARGIN
    steps = torch.tensor(known.disparities, dtype=torch.float64).diff()
    torch.testing.assert_close(steps, torch.full_like(steps, wiener_filters.STEP))


@pytest.mark.parametrize("disparity", [-1.0, 0.0, 0.03, 0.4])
def test_the_mean_of_what_was_found_is_the_disparity_found(disparity):
    known = wiener_filters.prior_of_map(torch.full((5, 6), disparity))
    inner = [
        (d, s - wiener_filters.BROAD / len(known.shares)) for d, s in zip(known.disparities, known.shares, strict=True)
    ]
    assert sum(s for _, s in inner) == pytest.approx(1 - wiener_filters.BROAD)
    assert share_near(known, disparity) > 1 - wiener_filters.BROAD


def test_rare_disparities_count_by_the_root_of_how_often_they_occur():
    rare = 16 * wiener_filters.STEP
    known = wiener_filters.prior_of_map(torch.tensor([0.0] * 9900 + [rare] * 100, dtype=torch.float64))
    doubt = wiener_filters.BROAD / len(known.shares)
    often, rarely = (share_near(known, d, wiener_filters.STEP / 2) - doubt for d in (0.0, rare))
    assert often / rarely == pytest.approx(math.sqrt(99), rel=1e-4)


def test_pixels_without_confidence_do_not_count():
    disparity, confidence = torch.tensor([0.0, 0.8]), torch.tensor([1.0, 0.0])
    known = wiener_filters.prior_of_map(disparity, confidence)
    assert share_near(known, 0.8) < 0.02
    assert share_near(known, 0.0) > 0.9


@pytest.mark.parametrize("values", [[math.nan], [0.0, math.inf], []])
def test_maps_with_holes_are_refused(values):
    with pytest.raises(InputError, match="disparities must be finite"):
        wiener_filters.prior_of_map(torch.tensor(values))


@pytest.mark.parametrize(("first", "last"), [(-1.0, 0.5), (0.5, -1.0)])
def test_between_two_disparities_all_are_alike(first, last):
    known = wiener_filters.prior_between(first, last)
    inside = [s for d, s in zip(known.disparities, known.shares, strict=True) if -0.9 < d < 0.4]
    outside = [s for d, s in zip(known.disparities, known.shares, strict=True) if not -1.1 < d < 0.65]
    assert max(inside) < 1.001 * min(inside)
    assert min(inside) > 10 * max(outside)


def test_power_by_hand():
    known = Prior((0.0,), (1.0,), aliased=0.25)
    row, column = torch.tensor(0.3, dtype=torch.float64), torch.tensor([0.4, -0.7], dtype=torch.float64)
    for x, aliased, power in zip(column.tolist(), (1.0, 0.25), known.power(row, column).tolist(), strict=True):
        pixel = (math.sin(math.pi * 0.3) / (math.pi * 0.3)) * (math.sin(math.pi * x) / (math.pi * x))
        fading = (1 + (0.3**2 + x**2) / wiener_filters.OUTER**2) ** (-wiener_filters.DECAY / 2)
        assert power == pytest.approx(aliased * fading * pixel**2, rel=1e-12)


def test_power_is_that_of_natural_pictures_between_the_lowest_and_the_pixel():
    k = torch.tensor([0.05, 0.1], dtype=torch.float64)
    near, far = Prior((0.0,), (1.0,)).power(torch.zeros(2, dtype=torch.float64), k) / torch.sinc(k).square()
    assert math.log2(near / far) == pytest.approx(wiener_filters.DECAY, abs=0.1)
    assert float(Prior((0.0,), (1.0,)).power(torch.zeros(1), torch.zeros(1))) == 1


def test_power_has_no_side():
    known, k = Prior((0.0,), (1.0,)), torch.linspace(-1.4, 1.4, 29, dtype=torch.float64)
    power = known.power(k[:, None], k)
    for other in (power.flip(0), power.flip(1), power.mT):
        torch.testing.assert_close(power, other, atol=1e-15, rtol=0)


def test_equal_priors_are_one_key():
    assert hash(wiener_filters.prior_between(-1, 0.5)) == hash(wiener_filters.prior_between(-1, 0.5))
