import pytest
import torch

from lfref.simulator.chance import Dice, Tone


def dice(seed=0):
    return Dice(torch.Generator().manual_seed(seed))


def test_what_never_happens_takes_no_number():
    one, other = dice(), dice()
    assert not any(one.happens(0.0) for _ in range(9))
    assert one.chosen([0.0, 0.0]) is None
    assert one.uniform() == other.uniform()


def test_what_always_happens_happens():
    assert all(dice(seed).happens(1.0) for seed in range(9))
    assert {dice(seed).chosen([0.0, 1.0, 0.0]) for seed in range(9)} == {1}


def test_cases_are_as_frequent_as_their_shares():
    thrown = dice()
    places = [thrown.chosen([0.2, 0.0, 0.5]) for _ in range(2000)]
    for place, share in ((0, 0.2), (1, 0.0), (2, 0.5), (None, 0.3)):
        assert places.count(place) / 2000 == pytest.approx(share, abs=0.04)
    assert sum(thrown.happens(0.3) for _ in range(2000)) / 2000 == pytest.approx(0.3, abs=0.04)


def test_every_thing_can_be_drawn():
    thrown = dice()
    assert {thrown.one_of("abc") for _ in range(40)} == set("abc")


def test_a_tone_keeps_grey_and_scales_what_differs_from_it():
    assert Tone(0.5, 0.0)((0.2, 0.4, 0.6)) == pytest.approx((0.2, 0.2, 0.2))
    assert Tone(1.0, 1.0)((0.2, 0.4, 0.6)) == pytest.approx((0.2, 0.4, 0.6))
