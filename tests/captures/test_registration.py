"""Registration: patches have the scene's disparities; displacements are explained exactly, without outliers."""

import dataclasses

import pytest
import torch

import lfref
from lfref import geometry
from lfref.captures import registration
from lfref.lightfield import LightField

from . import displaced
from .displaced import rms
from .scenes import clean, registered, registered_clean

PLACES = torch.cartesian_prod(*[geometry.angular_offsets(5)] * 2)
LINEAR = registration.linear_shifts(PLACES)
CERTAIN = 1e6 * torch.eye(2, dtype=torch.float64).expand(30, 2, 2)
SHOWN = torch.ones(30, 25, dtype=torch.float64)


def test_patches_of_a_plane_have_its_disparity():
    result = registered_clean("plane")
    disparities = result.explanation.disparities
    torch.testing.assert_close(disparities, torch.full_like(disparities, -1 / 3), atol=0.01, rtol=0)
    assert sum(int(quarter.sum()) for quarter in result.quarters()) == len(result.patches.rows)


def test_patches_are_shown_by_views_with_weight_there():
    field = clean("plane")
    weight = torch.ones(7, 7, 1, *field.size)
    weight[0, 0] = 0
    weight[6, 6, :, :, :96] = 0
    shown = registered(dataclasses.replace(field, weight=weight)).observed.shown.unflatten(1, (7, 7))
    assert not shown[:, 0, 0].any()
    assert 0 < float(shown[:, 6, 6].mean()) < 1
    assert bool(shown[:, 3, 3].all())


def drawn():
    """Shifts without linear parts, disparities, and the displacements that follow."""
    disparities = torch.randn(30, 2, dtype=torch.float64)
    modes, _ = torch.linalg.qr(LINEAR)
    shifts = torch.randn(50, dtype=torch.float64)
    shifts = (shifts - modes @ (modes.mT @ shifts)).unflatten(0, (25, 2))
    return shifts, disparities, shifts + disparities[:, None] * PLACES


def test_shifts_and_disparities_are_explained():
    shifts, disparities, moved = drawn()
    explanation = registration.explain(CERTAIN, moved, SHOWN, PLACES, LINEAR)
    torch.testing.assert_close(explanation.shifts, shifts, atol=1e-4, rtol=0)
    torch.testing.assert_close(explanation.disparities, disparities, atol=1e-4, rtol=0)


def test_outliers_and_hidden_patches_have_no_influence():
    shifts, _, moved = drawn()
    moved = moved + 1e-3 * torch.randn_like(moved)
    moved[3, 5], moved[7, 1], moved[9] = 5.0, -4.0, moved[9] + torch.randn(25, 2)
    shown = SHOWN.clone()
    moved[:6, 8], shown[:6, 8] = 100.0, 0.0
    explanation = registration.explain(CERTAIN, moved, shown, PLACES, LINEAR)
    torch.testing.assert_close(explanation.shifts, shifts, atol=5e-3, rtol=0)
    assert float(explanation.trust[3, 5]) < 0.01


def test_linear_shifts_are_disparities_or_nothing():
    _, disparities, _ = drawn()
    linear = 0.3 * PLACES + 0.2
    moved = disparities[:, None] * PLACES + 0.3 * PLACES
    explanation = registration.explain(CERTAIN, moved, SHOWN, PLACES, LINEAR)
    assert float(explanation.shifts.abs().max()) < 1e-6
    torch.testing.assert_close(explanation.disparities, disparities + 0.3, atol=1e-6, rtol=0)
    modes = LINEAR[:, registration.PROPORTIONAL]
    torch.testing.assert_close(modes @ (modes.mT @ linear.flatten()), linear.flatten())
    torch.testing.assert_close(modes.mT @ modes, torch.eye(4, dtype=torch.float64))


@pytest.mark.parametrize(
    ("strongest", "across", "expected"), [(1.0, 0.008, 0.0), (1.0, 0.012, 0.002), (1e9, 1e9, 2500)]
)
def test_information_is_limited_across_stripes_and_to_two_hundredths_of_a_pixel(strongest, across, expected):
    limited = registration.limited(torch.diag(torch.tensor([strongest, across], dtype=torch.float64)))
    assert float(limited[1, 1]) == pytest.approx(expected, rel=0.01, abs=1e-9)


def found_in(field):
    return registration.find_alignment(registered(field))


@pytest.mark.parametrize("name", ["shards", "leaves"])
def test_known_shifts_are_estimated(name):
    truth = displaced.shifts()
    defect = found_in(displaced.misaligned(name, truth))
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


@pytest.mark.parametrize(("name", "hole"), [("shards", (0, 0)), ("leaves", (2, 2)), ("leaves", (6, 3))])
def test_a_missing_view_takes_up_no_shifts_of_the_others(name, hole):
    field, weight = clean(name), torch.ones(7, 7, 1, *clean(name).size)
    weight[hole] = 0
    result = registered(dataclasses.replace(field, views=field.views * weight, weight=weight))
    shifts = result.explanation.shifts.unflatten(0, (7, 7))
    assert float(shifts[hole].abs().max()) < 1e-9
    assert isinstance(registration.find_alignment(result), str)
    assert rms(shifts.flatten(0, 1) - registered_clean(name).explanation.shifts) < 0.003


@pytest.mark.parametrize("name", ["shards", "stripes", "window", "gloss", "mirror", "running", "lattice"])
def test_scenes_without_misalignment_stay_as_they_are(name):
    assert isinstance(registration.find_alignment(registered_clean(name)), str)


def test_corrected_views_are_those_of_the_scene():
    field = displaced.misaligned("shards", displaced.shifts())
    inside = (..., slice(8, -8), slice(8, -8))
    before = rms((field.views - clean("shards").views)[inside])
    after = rms((found_in(field).corrected(field).views - clean("shards").views)[inside])
    assert after < before / 5


def test_both_halves_of_a_real_capture_have_the_same_shifts(lytro):
    field = lfref.read(lytro, encoding="linear")
    halves = (registered(field.crop(0, start, 300, 330)) for start in (0, 222))
    left, right = (half.explanation.shifts for half in halves)
    assert rms(left - right) < 0.05
    assert float((left * right).sum() / (left.norm() * right.norm())) > 0.3


@pytest.mark.parametrize("ratio", [0.9, 1.04, 1.2])
def test_a_known_ratio_is_estimated_to_half_a_percent(ratio):
    defect = registration.find_spacing(registered(displaced.stretched("leaves", ratio)))
    assert defect.ratio == pytest.approx(ratio, rel=5e-3)
    assert f"[{defect.ratio:.4f},1]" in defect.summary()


@pytest.mark.parametrize("name", ["leaves", "plane", "stripes", "window", "lattice"])
def test_even_grids_stay_even(name):
    assert isinstance(registration.find_spacing(registered_clean(name)), str)


@pytest.mark.parametrize(
    "views",
    [torch.rand(1, 2, 3, 96, 96), torch.full((3, 3, 3, 96, 96), 0.5), torch.rand(5, 5, 3, 40, 40)],
    ids=["few", "flat", "small"],
)
def test_views_that_cannot_be_registered_stay_in_their_places(views):
    assert registered(LightField(views)) is None
    assert registration.find_alignment(None) == registration.find_spacing(None) == registration.UNKNOWN
