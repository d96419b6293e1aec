"""Reading a view at x + shift: the exact shift against the plain trigonometric sum, borders, what counts."""

import pytest
import torch

from lfref.refocus.sampling import BORDERS, INTERPOLATIONS
from lfref.refocus.shift import shift_torch
from lfref.refocus.shift.shift_plan import Plan, Shifts
from lfref.refocus.shift.shift_torch import SEAM
from tests.refocus.conftest import dirichlet


def planned(view, name, border, shift):
    """The plan of shifting one view."""
    shifts = Shifts((INTERPOLATIONS[name].snap(shift),), ((INTERPOLATIONS[name].snap(shift),),))
    size = view.shape[-2:]
    return Plan((shifts,), ((1.0,),), size, INTERPOLATIONS[name], BORDERS[border])


def read(view, name, border, shift, axis=-1, start=0.0):
    """The view read at x + shift, onto a sum that is something already."""
    plan, total = planned(view, name, border, shift), torch.full_like(view, start)
    extended, pad = shift_torch.extended(view, plan, axis)
    shift_torch.add(total, extended, pad, plan.planes[0].rows[0], plan, axis)
    return total


@pytest.mark.parametrize("length", [16, 17])
@pytest.mark.parametrize("shift", [0.5, -2.3, 4.0])
def test_exact_on_a_periodic_view_is_the_trigonometric_sum(length, shift):
    view = torch.rand(3, length, dtype=torch.float64)
    expected = view @ dirichlet(length, shift).T
    torch.testing.assert_close(read(view, "exact", "wrap", shift), expected, atol=1e-12, rtol=0)


@pytest.mark.parametrize("border", ["edge", "zero"])
def test_exact_meets_no_jump_where_the_extended_view_starts_over(border):
    view = torch.rand(1, 24, dtype=torch.float64) + 1
    extended, pad = shift_torch.extended(view, planned(view, "exact", border, 2.0), -1)
    assert pad == 3 + SEAM
    assert torch.equal(extended[0, pad:-pad], view[0])
    # What a shift by the reach can read is the border's own continuation, untouched by the fade.
    plain = BORDERS[border].extend(view, 3, -1)
    assert torch.equal(extended[0, SEAM:-SEAM], plain[0])
    steps = extended.roll(-1, -1) - extended
    around = torch.cat([steps[0, -SEAM - 1 :], steps[0, :SEAM]])
    jump = abs(float(plain[0, 0] - plain[0, -1]))
    assert around.abs().max() <= jump * torch.pi / (4 * SEAM) + 1e-12
