"""Guides: each what it says, for any grid and planes."""

import pytest
import torch

from lfref.errors import InputError
from lfref.lightfield import LightField
from lfref.refocuser.features import GUIDES, OFFERS, Seen, check, guides

from .cases import BASE, SLOPES, seen

CHANNELS = {
    "fine": 3,
    "middle": 3,
    "coarse": 3,
    "sum": 3,
    "cells": 3,
    "central": 3,
    "picture": 3,
    "inner": 1,
    "spread": 1,
    "defocus": 2,
    "relief": 2,
    "coverage": 1,
    "fraction": 1,
    "views": 1,
    "doubt": 1,
    "chance": 1,
}


@pytest.mark.parametrize("grid", [(3, 3), (5, 5), (4, 7)])
def test_they_have_their_channels_at_every_plane_of_any_grid(grid):
    for name, n_channels in CHANNELS.items():
        assert GUIDES[name](seen(grid)).expand(3, -1, -1, -1).shape == (3, n_channels, 40, 48)
    assert set(CHANNELS) == set(GUIDES)


def test_they_stand_one_after_the_other_in_the_order_asked_for():
    light = seen()
    made = guides(light, ("spread", "picture"))
    assert made.shape == (3, 4, 40, 48)
    torch.testing.assert_close(made[:, 1:] + 0.5, BASE(light.light, SLOPES))


def test_differences_are_told_in_units_of_the_doubt_whatever_the_light():
    light = seen()
    for name in (*OFFERS, "inner", "spread"):
        dim = Seen(LightField(light.light.views / 8), SLOPES, BASE)
        # The map of disparities, which cells depend on, is made of other numbers: here and there it differs.
        assert float((GUIDES[name](dim) - GUIDES[name](light)).abs().median()) < 0.02, name


def test_whole_slopes_are_told_from_others():
    found = Seen(seen().light, torch.tensor([-3.0, 0.5, 1.75], dtype=torch.float64), BASE)
    assert GUIDES["fraction"](found)[:, 0, 3, 4].tolist() == [0.0, 1.0, 0.5]


def test_an_unknown_guide_is_refused():
    with pytest.raises(InputError, match="guide"):
        guides(seen(), ("luck",))


@pytest.mark.parametrize("names", [(), ("fine",), ("fine", "picture"), ("spread", "fine", "sum")])
def test_guides_that_corrections_cannot_be_mixed_of_are_refused(names):
    check(("fine", "sum", *names), 2)
    with pytest.raises(InputError, match="the first 2 guides must be among fine, middle"):
        check(names, 2)
