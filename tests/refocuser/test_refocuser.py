"""What all refocusers share: what they take and refuse, which planes they make, and names that stay apart."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lfref.errors import InputError
from lfref.lightfield import LightField
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.operators import OperatorRefocuser
from lfref.refocuser.refocuser import name_apart

SLOPES = [-0.5, 0.0, 0.4]


def named(*names):
    made = [OperatorRefocuser(name, shift_and_sum) for name in names]
    name_apart(made)
    return [refocuser.name for refocuser in made]


@pytest.mark.parametrize("operator", [shift_and_sum, exact_fourier])
def test_a_light_field_and_its_views_give_the_operators_stack(operator):
    field, refocuser = LightField(torch.rand(3, 3, 1, 8, 9)), OperatorRefocuser("name", operator)
    expected = operator(field.views, SLOPES)
    assert torch.equal(refocuser(field, SLOPES), expected)
    assert torch.equal(refocuser(field.views, torch.tensor(SLOPES, dtype=torch.float64)), expected)
    assert torch.equal(refocuser(field.views[None], SLOPES), expected[None])


@pytest.mark.parametrize(
    ("views", "complaint"),
    [
        (
            np.zeros((3, 3, 1, 8, 8), np.float32),
            "LightField; got <class 'numpy.ndarray'>; torch.from_numpy",
        ),
        (torch.zeros(3, 3, 1, 8, 8, dtype=torch.int32), "uint8 or uint16; got torch.int32"),
        (torch.zeros(3, 3, 1, 8, 8, dtype=torch.bool), "uint8 or uint16; got torch.bool"),
        (torch.zeros(3, 3, 8, 8), r"must be \[..., V, U, C, H, W\]"),
    ],
)
def test_what_are_no_views_is_refused(views, complaint):
    with pytest.raises(InputError, match=complaint):
        OperatorRefocuser("name", shift_and_sum)(views, SLOPES)


def test_who_makes_any_planes_must_be_told_which():
    with pytest.raises(InputError, match="name refocuses to any planes; got none; give slopes"):
        OperatorRefocuser("name", shift_and_sum)(torch.rand(3, 3, 1, 8, 8))


def test_names_that_occur_twice_get_a_number():
    assert named("a", "b", "a", "a") == ["a", "b", "a (2)", "a (3)"]


@given(names=st.lists(st.sampled_from(["a", "b", "a (2)"]), max_size=8))
def test_all_names_differ_and_begin_as_they_did(names):
    made = named(*names)
    assert len(set(made)) == len(names)
    assert all(new.startswith(old) for new, old in zip(made, names, strict=True))
