"""Alignment: known shifts of views are estimated and undone; scenes without any stay as they are."""

import dataclasses
from types import SimpleNamespace

import pytest
import torch

import lfref
from lfref.captures import alignment, registration
from lfref.captures.alignment import AlignmentDefect
from lfref.lightfield import LightField

from . import displaced
from .displaced import rms
from .scenes import clean, registered, registered_clean


def found_in(field):
    return alignment.find(field.grid, registered(field))


@pytest.mark.parametrize("name", ["shards", "leaves"])
def test_known_shifts_are_estimated(name):
    truth = displaced.shifts()
    defect = found_in(displaced.misaligned(name, truth))
    assert defect.reason_to_skip() is None
    assert rms(defect.shifts - truth) < 0.01
    assert "px" in defect.summary()


@pytest.mark.parametrize("disturbed", ["noise", "shading"])
def test_noise_and_shading_do_not_move_views(disturbed):
    truth = displaced.shifts()
    field = displaced.misaligned("shards", truth)
    gains = torch.linspace(0.4, 1.2, 49).reshape(7, 7, 1, 1, 1)
    shaded = dataclasses.replace(field, views=0.05 + gains * field.views)
    defect = found_in(displaced.noisy(field) if disturbed == "noise" else shaded)
    assert rms(defect.shifts - truth) < 0.01


def test_views_without_weight_move_no_others():
    truth = displaced.shifts()
    field = displaced.misaligned("shards", truth)
    weight = torch.ones(7, 7, 1, *field.size)
    field.views[::6, ::6], weight[::6, ::6] = 0, 0
    defect = found_in(dataclasses.replace(field, weight=weight))
    inside = weight.amax((2, 3, 4)) > 0
    places = registration.positions_of(field).unflatten(0, (7, 7))
    linear = torch.cat([places, torch.ones(7, 7, 1)], -1).double()[inside]
    error = (defect.shifts - truth)[inside]
    assert rms(error - linear @ torch.linalg.lstsq(linear, error).solution) < 0.01


@pytest.mark.parametrize("name", ["shards", "stripes", "window", "gloss", "mirror", "running", "lattice"])
def test_scenes_without_misalignment_stay_as_they_are(name):
    assert alignment.find((7, 7), registered_clean(name)).reason_to_skip() is not None


def test_noise_is_no_misalignment():
    assert found_in(displaced.noisy(clean("leaves"), 0.05)).reason_to_skip() is not None


@pytest.mark.parametrize(
    ("shift", "error", "is_corrected"),
    [(0.022, 0.0, True), (0.018, 0.0, False), (0.11, 0.02, True), (0.09, 0.02, False), (9.0, float("inf"), False)],
)
def test_shifts_are_corrected_from_two_hundredths_of_a_pixel_and_five_standard_errors(shift, error, is_corrected):
    defect = AlignmentDefect(torch.full((3, 3, 2), shift), error)
    assert (defect.reason_to_skip() is None) == is_corrected


@pytest.mark.parametrize(("size", "is_kept"), [(2.8, True), (3.2, False)])
def test_linear_parts_count_up_to_three_times_the_other_shifts(size, is_kept):
    others = 0.1 * displaced.shifts().flatten(0, 1) / rms(displaced.shifts())
    positions = registration.positions_of(clean("shards"))
    linear = registration.linear_shifts(positions)[:, 4].unflatten(0, (49, 2))
    both = others + size * 0.1 * linear
    stub = SimpleNamespace(
        positions=positions,
        explanation=SimpleNamespace(shifts=others),
        explain=lambda unknown, chosen=None: SimpleNamespace(shifts=both if unknown.shape[1] == 4 else others),
        quarters=lambda: range(4),
    )
    expected = both if is_kept else others
    torch.testing.assert_close(alignment.find((7, 7), stub).shifts, expected.unflatten(0, (7, 7)))


def test_corrected_views_are_those_of_the_scene():
    field = displaced.misaligned("shards", displaced.shifts())
    inside = (..., slice(8, -8), slice(8, -8))
    before = rms((field.views - clean("shards").views)[inside])
    after = rms((found_in(field).corrected(field).views - clean("shards").views)[inside])
    assert after < before / 5


@pytest.mark.parametrize("shape", [(1, 2), (3, 3)])
def test_flat_views_stay_in_their_places(shape):
    defect = found_in(LightField(torch.full((*shape, 3, 80, 96), 0.5)))
    assert "too little texture" in defect.reason_to_skip()
    assert not defect.shifts.any()


def test_a_single_row_of_views_is_aligned():
    truth = displaced.shifts()[3]
    field = displaced.misaligned("shards", displaced.shifts())
    defect = found_in(dataclasses.replace(field, views=field.views[3:4]))
    across = torch.linspace(-1, 1, 7, dtype=torch.float64)
    # Linear parts are unknown along the row, and cannot be trusted across it.
    linear = torch.stack([torch.ones(7, dtype=torch.float64), across], -1)
    error = defect.shifts[0] - truth
    assert rms(error - linear @ torch.linalg.lstsq(linear, error).solution) < 0.02


def test_both_halves_of_a_real_capture_have_the_same_shifts(lytro):
    field = lfref.read(lytro, encoding="linear")
    left, right = (found_in(field.crop(0, start, 300, 330)).shifts for start in (0, 222))
    assert rms(left - right) < 0.05
    assert float((left * right).sum() / (left.norm() * right.norm())) > 0.3
