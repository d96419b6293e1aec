"""Explained displacements: shifts and disparities come back exactly; outliers have no say, what is unknown stays 0."""

import torch

from lfref import geometry
from lfref.captures import registration

PLACES = torch.cartesian_prod(*[geometry.angular_offsets(5)] * 2)
SURE = 100 * torch.eye(2, dtype=torch.float64).expand(30, 2, 2)
SHOWN = torch.ones(30, 25, dtype=torch.float64)


def drawn():
    disparities = torch.randn(30, 2, dtype=torch.float64)
    modes, _ = torch.linalg.qr(registration.linear_shifts(PLACES))
    shifts = torch.randn(50, dtype=torch.float64)
    shifts = (shifts - modes @ (modes.mT @ shifts)).unflatten(0, (25, 2))
    return shifts, disparities, shifts + disparities[:, None] * PLACES


def test_shifts_and_disparities_come_back():
    shifts, disparities, moved = drawn()
    found = registration.explain(1e4 * SURE, moved, SHOWN, PLACES, registration.linear_shifts(PLACES))
    torch.testing.assert_close(found.shifts, shifts, atol=1e-4, rtol=0)
    torch.testing.assert_close(found.disparities, disparities, atol=1e-4, rtol=0)


def test_outliers_and_what_is_not_shown_have_no_say():
    shifts, _, moved = drawn()
    moved = moved + 1e-3 * torch.randn_like(moved)
    moved[3, 5], moved[7, 1], moved[9] = 5.0, -4.0, moved[9] + torch.randn(25, 2)
    shown = SHOWN.clone()
    moved[:6, 8], shown[:6, 8] = 100.0, 0.0
    found = registration.explain(1e4 * SURE, moved, shown, PLACES, registration.linear_shifts(PLACES))
    torch.testing.assert_close(found.shifts, shifts, atol=5e-3, rtol=0)
    assert float(found.trust[3, 5]) < 0.01


def test_what_cannot_be_known_is_a_disparity_or_nothing():
    _, disparities, _ = drawn()
    linear = 0.3 * PLACES + 0.2
    found = registration.explain(
        1e4 * SURE, disparities[:, None] * PLACES + 0.3 * PLACES, SHOWN, PLACES, registration.linear_shifts(PLACES)
    )
    assert float(found.shifts.abs().max()) < 1e-6
    torch.testing.assert_close(found.disparities, disparities + 0.3, atol=1e-6, rtol=0)
    modes = registration.proportional_shifts(PLACES)
    torch.testing.assert_close(modes @ (modes.mT @ linear.flatten()), linear.flatten())
    torch.testing.assert_close(modes.mT @ modes, torch.eye(4, dtype=torch.float64))
