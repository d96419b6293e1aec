"""Alignment: known shifts of views come back and are taken off; scenes without any stay as they are."""

import dataclasses

import pytest
import torch

import lfref
from lfref.captures import alignment, registration
from lfref.captures.estimates import Estimates
from lfref.lightfield import LightField

from . import displaced
from .displaced import rms


@pytest.mark.parametrize("name", ["shards", "leaves", "dome"])
def test_known_shifts_come_back(name):
    truth = displaced.shifts()
    found = alignment.find(Estimates(displaced.misaligned(name, truth)))
    assert found.reason_to_skip() is None
    assert rms(found.shifts - truth) < 0.01
    assert "px" in found.summary()


def test_in_noise_shifts_come_back_to_a_hundredth_of_a_pixel():
    truth = displaced.shifts()
    found = alignment.find(Estimates(displaced.noisy(displaced.misaligned("shards", truth))))
    assert rms(found.shifts - truth) < 0.01


def test_shading_and_contrast_of_views_do_not_move_them():
    truth = displaced.shifts()
    field = displaced.misaligned("shards", truth)
    gains = torch.linspace(0.4, 1.2, 49).reshape(7, 7, 1, 1, 1)
    found = alignment.find(Estimates(dataclasses.replace(field, views=0.05 + gains * field.views)))
    assert rms(found.shifts - truth) < 0.01


def test_views_that_do_not_count_move_no_others():
    truth = displaced.shifts()
    field = displaced.misaligned("shards", truth)
    weight = torch.ones(7, 7, 1, *field.size)
    for corner in [(0, 0), (0, 6), (6, 0), (6, 6)]:
        field.views[corner], weight[corner] = 0, 0
    found = alignment.find(Estimates(dataclasses.replace(field, weight=weight)))
    inside = weight.amax((2, 3, 4)) > 0
    places = torch.cat([registration.positions_of(field).unflatten(0, (7, 7)), torch.ones(7, 7, 1)], -1).double()[
        inside
    ]
    left = (found.shifts - truth)[inside]
    assert rms(left - places @ torch.linalg.lstsq(places, left).solution) < 0.01


@pytest.mark.parametrize("name", ["shards", "stripes", "wall", "window", "gloss", "mirror", "running", "lattice"])
def test_scenes_without_fault_stay_as_they_are(name):
    found = alignment.find(displaced.estimates(name))
    assert found.reason_to_skip() is not None


def test_noise_is_no_misalignment():
    assert alignment.find(Estimates(displaced.noisy(displaced.scene("leaves"), 0.05))).reason_to_skip() is not None


def test_corrected_views_are_those_of_the_scene():
    truth = displaced.shifts()
    field = displaced.misaligned("shards", truth)
    found = alignment.find(Estimates(field))
    inside = (..., slice(8, -8), slice(8, -8))
    before = rms((field.views - displaced.scene("shards").views)[inside])
    after = rms((found.corrected(field).views - displaced.scene("shards").views)[inside])
    assert after < before / 5


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (3, 3)])
def test_where_nothing_is_to_be_seen_nothing_moves(shape):
    found = alignment.find(Estimates(LightField(torch.full((*shape, 3, 80, 96), 0.5))))
    assert "too little texture" in found.reason_to_skip()
    assert not found.shifts.any()


def test_a_single_row_of_views_is_aligned():
    truth = displaced.shifts()[3:4].clone()
    field = displaced.misaligned("shards", displaced.shifts())
    row = dataclasses.replace(field, views=field.views[3:4])
    found = alignment.find(Estimates(row))
    across = torch.linspace(-1, 1, 7, dtype=torch.float64)
    linear = torch.stack([torch.ones(7, dtype=torch.float64), across], -1)
    rest = truth[0] - linear @ torch.linalg.lstsq(linear, truth[0]).solution
    # What is linear in the place cannot be told along the row, nor trusted across it.
    moved = found.shifts[0] - linear @ torch.linalg.lstsq(linear, found.shifts[0]).solution
    assert rms(moved - rest) < 0.02


def test_two_ends_of_a_real_capture_tell_the_same_of_its_views(lytro):
    field = lfref.read(lytro, encoding="linear")
    found = [alignment.find(Estimates(field.crop(0, left, 300, 330))) for left in (0, 222)]
    differences = found[0].shifts - found[1].shifts
    assert rms(differences) < 0.05
    together = (found[0].shifts * found[1].shifts).sum()
    assert float(together / (found[0].shifts.norm() * found[1].shifts.norm())) > 0.3
