"""Chromatic aberration: known sizes and focuses of colours come back and are taken off; colours that agree stay."""

import pytest
import torch

from lfref.captures import chromatic
from lfref.captures.estimates import Estimates
from lfref.lightfield import LightField

from . import displaced
from .displaced import rms

SIZES, FOCUS = (1.004, 1.0, 0.997), (0.05, 0.0, -0.04)


@pytest.mark.parametrize("name", ["shards", "leaves"])
def test_known_sizes_and_focuses_come_back(name):
    found = chromatic.find(Estimates(displaced.dispersed(name, SIZES, FOCUS)))
    assert found.reason_to_skip() is None
    torch.testing.assert_close(found.magnifications, torch.tensor(SIZES).double(), atol=4e-4, rtol=0)
    torch.testing.assert_close(found.disparities, torch.tensor(FOCUS).double(), atol=4e-3, rtol=0)
    assert "channel 0" in found.summary()
    assert "channel 1" not in found.summary()


def test_corrected_views_are_those_of_the_scene():
    field = displaced.dispersed("shards", SIZES, FOCUS)
    found = chromatic.find(Estimates(field))
    inside = (..., slice(16, -16), slice(16, -16))
    before = rms((field.views - displaced.scene("shards").views)[inside])
    after = rms((found.corrected(field).views - displaced.scene("shards").views)[inside])
    assert after < before / 3


def test_a_colour_that_lies_beside_is_said_and_put_back():
    field = displaced.scene("shards")
    beside = torch.zeros(3, 2, dtype=torch.float64)
    beside[0] = torch.tensor([0.3, -0.2])
    still = torch.ones(3, dtype=torch.float64)
    # The inverse of a shift is the shift back.
    moved = chromatic.ChromaticDefect(still, -beside, 0 * still).corrected(field)
    assert rms(moved.views[:, :, 1:] - field.views[:, :, 1:]) == 0
    back = chromatic.ChromaticDefect(still, beside, 0 * still).corrected(moved)
    assert rms((back.views - field.views)[..., 8:-8, 8:-8]) < 0.2 * rms((moved.views - field.views)[:, :, 0])


@pytest.mark.parametrize("name", ["shards", "lattice", "thicket", "veil", "window", "lamps", "discs"])
def test_colours_that_agree_stay_as_they_are(name):
    assert chromatic.find(displaced.estimates(name)).reason_to_skip() is not None


def test_noise_is_no_aberration():
    assert chromatic.find(Estimates(displaced.noisy(displaced.scene("shards"), 0.05))).reason_to_skip() is not None


def test_one_channel_has_nothing_to_agree_with():
    assert "one channel" in chromatic.find(Estimates(LightField(torch.rand(3, 3, 1, 80, 96)))).reason_to_skip()


def test_flat_pictures_tell_nothing():
    found = chromatic.find(Estimates(LightField(torch.full((3, 3, 3, 80, 96), 0.5))))
    assert "too little texture" in found.reason_to_skip()
