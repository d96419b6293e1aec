"""Chromatic aberration: known sizes and focuses of colours are estimated and undone; colours that agree stay."""

import pytest
import torch

from lfref.captures import chromatic
from lfref.captures.displacements import Fitted
from lfref.lightfield import LightField

from . import displaced
from .displaced import rms
from .scenes import clean, registered, registered_clean

SIZES, FOCUS = (1.004, 1.0, 0.997), (0.05, 0.0, -0.04)


def found_in(field):
    return chromatic.find(field, registered(field))


@pytest.mark.parametrize("name", ["shards", "leaves"])
def test_known_sizes_and_focuses_are_estimated(name):
    defect = found_in(displaced.dispersed(name, SIZES, FOCUS))
    torch.testing.assert_close(defect.magnifications, torch.tensor(SIZES).double(), atol=4e-4, rtol=0)
    torch.testing.assert_close(defect.disparities, torch.tensor(FOCUS).double(), atol=4e-3, rtol=0)
    assert ", 1.00000, " in defect.summary()


def test_corrected_views_are_those_of_the_scene():
    field = displaced.dispersed("shards", SIZES, FOCUS)
    inside = (..., slice(16, -16), slice(16, -16))
    before = rms((field.views - clean("shards").views)[inside])
    after = rms((found_in(field).corrected(field).views - clean("shards").views)[inside])
    assert after < before / 3


@pytest.mark.parametrize("name", ["shards", "lattice", "thicket", "veil", "window", "lamps"])
def test_colours_that_agree_stay_as_they_are(name):
    assert isinstance(chromatic.find(clean(name), registered_clean(name)), str)


def test_one_channel_and_flat_pictures_have_nothing_to_compare():
    assert "one channel" in found_in(LightField(torch.rand(3, 3, 1, 80, 96)))
    assert "too little texture" in found_in(LightField(torch.full((3, 3, 3, 80, 96), 0.5)))


def fitted(values, errors, effect=1.0, scatter=0.0):
    return Fitted(torch.tensor(values), torch.tensor(errors), effect, scatter)


NO_OFFSET, NOT_AXIAL = [0.0, 0.0, 0.01], fitted([0.0], [0.0])


@pytest.mark.parametrize(
    ("lateral", "expected"),
    [
        (fitted(NO_OFFSET, [0, 0, 0.0022]), True),  # four standard errors
        (fitted(NO_OFFSET, [0, 0, 0.0028]), False),
        (fitted(NO_OFFSET, [0, 0, 0.0], effect=0.022), True),  # pixels on average
        (fitted(NO_OFFSET, [0, 0, 0.0], effect=0.018), False),
        (fitted(NO_OFFSET, [0, 0, 0.0], effect=1.0, scatter=1.5), True),  # .6 of the scatter of patches
        (fitted(NO_OFFSET, [0, 0, 0.0], effect=1.0, scatter=1.8), False),
    ],
)
def test_a_magnification_counts_if_it_is_certain_shows_and_exceeds_the_scatter(lateral, expected):
    assert chromatic.is_certain(lateral, NOT_AXIAL, 3.0) == [expected, False]


@pytest.mark.parametrize(
    ("disparity", "error", "scatter", "expected"),
    [
        (-0.9, 0.2, 0.0, True),  # four standard errors
        (-0.7, 0.2, 0.0, False),
        (0.0075, 0.0, 0.0, True),  # .02 pixels in the outermost view
        (0.0060, 0.0, 0.0, False),
        (0.9, 0.0, 0.8, True),  # the scatter of patches
        (0.7, 0.0, 0.8, False),
    ],
)
def test_a_focus_counts_if_it_is_certain_shows_and_exceeds_the_scatter(disparity, error, scatter, expected):
    axial = fitted([disparity], [error], scatter=scatter)
    nothing = fitted([0.0, 0.0, 0.0], [0, 0, 0.0])
    assert chromatic.is_certain(nothing, axial, 3.0) == [False, expected]
