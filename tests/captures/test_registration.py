"""Registration: patches have the scene's disparities; displacements are explained exactly, without outliers."""

import dataclasses

import pytest
import torch
from torch.nn import functional as F

from lfref import geometry
from lfref.captures import displacements, registration
from lfref.captures.displacements import Observed
from lfref.lightfield import LightField

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


def test_quarters_without_patches_are_left_out():
    result = registered_clean("plane")
    falling = torch.arange(len(result.patches.rows))
    quarters = result._replace(patches=result.patches._replace(rows=falling, columns=falling)).quarters()
    assert len(quarters) == 2
    assert bool((quarters[0] ^ quarters[1]).all())


def test_half_of_the_patches_have_the_same_shifts():
    result = registered_clean("shards")
    half = torch.arange(len(result.patches.rows)) % 2 == 0
    part = result.explain(registration.linear_shifts(result.positions), half)
    assert float((part.shifts - result.explanation.shifts).abs().max()) < 0.02


def test_patches_are_shown_by_views_with_weight_there():
    field = clean("plane")
    weight = torch.ones(7, 7, 1, *field.size)
    weight[0, 0] = 0
    weight[6, 6, :, :, :96] = 0
    shown = registered(dataclasses.replace(field, weight=weight)).observed.shown.unflatten(1, (7, 7))
    assert not shown[:, 0, 0].any()
    assert 0 < float(shown[:, 6, 6].mean()) < 1
    assert bool(shown[:, 3, 3].all())


@pytest.mark.parametrize(
    "views", [torch.rand(1, 2, 3, 96, 96), torch.full((3, 3, 3, 96, 96), 0.5), torch.rand(5, 5, 3, 40, 40)]
)
def test_few_or_flat_views_cannot_be_registered(views):
    assert registered(LightField(views)) is None


def smooth_views(moved=0.0):
    """25 views of a smooth random texture at disparity 0; one of them lies lower."""
    noise = F.conv2d(torch.rand(1, 1, 120, 136), torch.ones(1, 1, 9, 9) / 81)
    noise = F.avg_pool2d(noise, 9, 1, 4)
    views = noise.expand(5, 5, 1, -1, -1).clone()
    views[1, 3, 0] = moved * noise[0, 0].roll(1, 0) + (1 - moved) * noise[0, 0]
    return LightField(views)


@pytest.mark.parametrize(("moved", "is_read_again"), [(0.065, False), (0.12, True)])
def test_patches_are_read_again_if_they_moved_by_eight_hundredths_of_a_pixel(moved, is_read_again):
    field = smooth_views(moved)
    result = registration.register(field, torch.zeros(field.size), (2, 2))
    first = result.patches.disparity[:, None, None] * result.positions
    assert torch.equal(result.expected, first) != is_read_again
    assert float(result.explanation.shifts.unflatten(0, (5, 5))[1, 3, 0]) == pytest.approx(moved, abs=0.03)


@pytest.mark.parametrize(("n", "is_enough"), [(11, False), (12, True)])
def test_a_registration_needs_a_dozen_patches(n, is_enough, monkeypatch):
    choose = displacements.choose_patches
    monkeypatch.setattr(displacements, "choose_patches", lambda *a: type(p := choose(*a))(*(part[:n] for part in p)))
    field = smooth_views()
    assert (registration.register(field, torch.zeros(field.size), (2, 2)) is not None) == is_enough


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


def test_a_displacement_two_standard_deviations_away_counts_half():
    _, _, moved = drawn()
    moved = moved + 0.1 * torch.randn_like(moved)
    result = registration.explain(CERTAIN, moved, SHOWN, PLACES, LINEAR)
    rest = moved - result.shifts - result.disparities[:, None] * PLACES
    distance = rest.square().sum(-1) / rest.square().sum(-1).median()
    torch.testing.assert_close(result.trust, 1 / (1 + distance / 4))


def test_shifts_of_little_evidence_are_half_as_large():
    # A prior of .3 pixels, and patches of the same information: displacements that are all alike but for their sign
    # count 1 / (1 + 1/4).
    places = torch.cartesian_prod(*[geometry.angular_offsets(4)] * 2)
    sign = (1 - 2.0 * ((torch.arange(4)[:, None] + torch.arange(4)) % 2)).double().flatten()
    moved = 0.1 * sign[:, None].expand(30, 16, 2)
    information = torch.eye(2, dtype=torch.float64).expand(30, 2, 2) / (0.8 * 30 * 0.3**2)
    unknown = registration.linear_shifts(places)
    shifts = registration.explain(information, moved, SHOWN[:, :16], places, unknown).shifts
    torch.testing.assert_close(shifts, moved[0] / 2, rtol=0.02, atol=0)


def test_linear_shifts_are_disparities_or_nothing():
    _, disparities, _ = drawn()
    linear = 0.3 * PLACES + 0.2
    moved = disparities[:, None] * PLACES + 0.3 * PLACES
    explanation = registration.explain(CERTAIN, moved, SHOWN, PLACES, LINEAR)
    assert float(explanation.shifts.abs().max()) < 1e-6
    torch.testing.assert_close(explanation.disparities, disparities + 0.3, atol=1e-6, rtol=0)
    modes = registration.proportional_shifts(PLACES)
    torch.testing.assert_close(modes @ (modes.mT @ linear.flatten()), linear.flatten())
    torch.testing.assert_close(modes.mT @ modes, torch.eye(4, dtype=torch.float64))


def test_noise_is_at_least_a_hundredth_of_the_contrast():
    templates = torch.rand(3, 2, 20, 20, dtype=torch.float64)
    zeros = torch.zeros(3, 2, 2, 2).double(), torch.zeros(3, 5, 2, 2).double(), torch.zeros(3, 5, 2).double()
    noise = registration.noise_of(Observed(*zeros, templates, torch.ones(3, 5)))
    torch.testing.assert_close(noise, (0.01 * templates.std((-2, -1))).square())


@pytest.mark.parametrize(
    ("strongest", "across", "expected"), [(1.0, 0.008, 0.0), (1.0, 0.012, 0.002), (1e9, 1e9, 2500)]
)
def test_information_is_limited_across_stripes_and_to_two_hundredths_of_a_pixel(strongest, across, expected):
    limited = registration.limited(torch.diag(torch.tensor([strongest, across], dtype=torch.float64)))
    assert float(limited[1, 1]) == pytest.approx(expected, rel=0.01, abs=1e-9)
