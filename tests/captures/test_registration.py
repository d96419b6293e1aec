"""Registration: patches have the scene's disparities; displacements are explained exactly, without outliers."""

import dataclasses
from types import SimpleNamespace

import pytest
import torch
from torch.nn import functional as F

import lfref
from lfref import geometry
from lfref.captures import displacements, registration
from lfref.captures.displacements import Observed
from lfref.captures.registration import positions_of
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


def found_in(field):
    return registration.find_alignment(field.grid, registered(field))


@pytest.mark.parametrize("name", ["shards", "leaves"])
def test_known_shifts_are_estimated(name):
    truth = displaced.shifts()
    defect = found_in(displaced.misaligned(name, truth))
    assert not defect.reason_to_skip
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


@pytest.mark.parametrize("hole", [(0, 0), (2, 2), (6, 3)])
@pytest.mark.parametrize("name", ["shards", "leaves"])
def test_a_missing_view_takes_up_no_shifts_of_the_others(name, hole):
    field, weight = clean(name), torch.ones(7, 7, 1, *clean(name).size)
    weight[hole] = 0
    defect = found_in(dataclasses.replace(field, views=field.views * weight, weight=weight))
    assert float(defect.shifts[hole].abs().max()) < 1e-9
    assert defect.reason_to_skip
    assert rms(defect.shifts - found_in(field).shifts) < 0.003


@pytest.mark.parametrize("name", ["shards", "stripes", "window", "gloss", "mirror", "running", "lattice"])
def test_scenes_without_misalignment_stay_as_they_are(name):
    assert registration.find_alignment((7, 7), registered_clean(name)).reason_to_skip


@pytest.mark.parametrize(
    ("shift", "error", "is_corrected"),
    [(0.022, 0.0, True), (0.018, 0.0, False), (0.11, 0.02, True), (0.09, 0.02, False)],
)
def test_shifts_are_corrected_from_two_hundredths_of_a_pixel_and_five_standard_errors(shift, error, is_corrected):
    shifts = torch.full((9, 2), shift).double()
    # Four quarters, of which the mean has this standard error.
    quarters = iter([shifts + sign * error * 3**0.5 for sign in (1, -1, 1, -1)])
    stub = SimpleNamespace(
        positions=torch.cartesian_prod(*[geometry.angular_offsets(3)] * 2),
        explanation=SimpleNamespace(shifts=shifts),
        explain=lambda unknown, chosen=None: SimpleNamespace(shifts=shifts if chosen is None else next(quarters)),
        quarters=lambda: range(4),
    )
    assert (not registration.find_alignment((3, 3), stub).reason_to_skip) == is_corrected


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
    torch.testing.assert_close(registration.find_alignment((7, 7), stub).shifts, expected.unflatten(0, (7, 7)))


def test_corrected_views_are_those_of_the_scene():
    field = displaced.misaligned("shards", displaced.shifts())
    inside = (..., slice(8, -8), slice(8, -8))
    before = rms((field.views - clean("shards").views)[inside])
    after = rms((found_in(field).corrected(field).views - clean("shards").views)[inside])
    assert after < before / 5


def test_both_halves_of_a_real_capture_have_the_same_shifts(lytro):
    field = lfref.read(lytro, encoding="linear")
    left, right = (found_in(field.crop(0, start, 300, 330)).shifts for start in (0, 222))
    assert rms(left - right) < 0.05
    assert float((left * right).sum() / (left.norm() * right.norm())) > 0.3


@pytest.mark.parametrize("ratio", [0.9, 1.04, 1.2])
def test_a_known_ratio_is_estimated_to_half_a_percent(ratio):
    defect = registration.find_spacing(registered(displaced.stretched("leaves", ratio)))
    assert not defect.reason_to_skip
    assert defect.ratio == pytest.approx(ratio, rel=5e-3)
    assert f"[{defect.ratio:.4f},1]" in defect.summary()


def test_every_second_column_makes_rows_half_as_far_apart():
    defect = registration.find_spacing(registered(LightField(clean("leaves").views[:, ::2])))
    assert defect.ratio == pytest.approx(0.5, rel=0.01)


@pytest.mark.parametrize("name", ["leaves", "plane", "stripes", "window", "lattice"])
def test_even_grids_stay_even(name):
    assert registration.find_spacing(registered_clean(name)).reason_to_skip


@pytest.mark.parametrize(
    "views",
    [torch.rand(1, 2, 3, 96, 96), torch.full((3, 3, 3, 96, 96), 0.5), torch.rand(5, 5, 3, 40, 40)],
    ids=["few", "flat", "small"],
)
def test_views_that_cannot_be_registered_stay_in_their_places(views):
    assert registered(LightField(views)) is None
    assert registration.find_alignment(views.shape[:2], None).reason_to_skip
    assert registration.find_spacing(None).reason_to_skip


@pytest.mark.parametrize(
    ("excess", "error", "outermost", "scatter", "expected"),
    [
        (0.11, 0.02, 9.0, 0.0, True),  # five standard errors
        (0.09, 0.02, 9.0, 0.0, False),
        (0.022, 0.0, 1.0, 0.0, True),  # a shift of .04 pixels of the outermost view
        (0.018, 0.0, 1.0, 0.0, False),
        (0.5, 0.0, 9.0, 1.5, True),  # .6 of the scatter of patches
        (0.5, 0.0, 9.0, 1.9, False),
    ],
)
def test_a_ratio_counts_if_it_is_certain_shows_and_exceeds_the_scatter(excess, error, outermost, scatter, expected):
    assert registration.is_certain(excess, error, torch.full((20,), 2.0), outermost, scatter) == expected


def patches(disparities, precision):
    """A registration of patches with these disparities [K, 2] and precisions [K, 2]."""
    return SimpleNamespace(
        explanation=SimpleNamespace(
            disparities=disparities, precision=precision, shifts=torch.zeros(49, 2, dtype=torch.float64)
        ),
        positions=positions_of(clean("leaves")),
    )


def differing(n, mean, difference, precision):
    """Patches whose disparities along rows and columns differ by so much."""
    disparities = torch.stack([mean + difference / 2, mean - difference / 2], 1)
    return patches(disparities, precision.expand(n, 2)), torch.arange(n)


SIGNS = (1 - 2.0 * (torch.arange(400) % 2)).double()
OTHER_SIGNS = (1 - 2.0 * (torch.arange(400) // 2 % 2)).double()


def test_a_ratio_of_little_evidence_is_half_as_far_from_one():
    # A prior of standard deviation .2 has as much information as these patches. With Cauchy weights, one at a standard
    # deviation pulls by .48 of its distance.
    deviation = 0.1
    mean = SIGNS * deviation * (25 / (0.48 * 400)) ** 0.5
    precision = torch.tensor(2 / deviation**2, dtype=torch.float64)
    fit, _ = registration.fit_ratio(*differing(400, mean, 0.1 * mean + deviation * OTHER_SIGNS, precision))
    assert float(fit.values[1]) == pytest.approx(0.05, rel=0.2)


def test_a_constant_difference_of_more_than_two_thousandths_of_a_pixel_per_view_is_unlikely():
    # A prior of that standard deviation has as much information as these patches; see above.
    deviation = 0.002 * (0.48 * 400) ** 0.5
    precision = torch.tensor(2 / deviation**2, dtype=torch.float64)
    fit, _ = registration.fit_ratio(*differing(400, SIGNS, 1e-3 + deviation * OTHER_SIGNS, precision))
    assert float(fit.values[0]) == pytest.approx(5e-4, rel=0.2)
