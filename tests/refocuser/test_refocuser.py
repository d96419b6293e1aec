"""What all refocusers share: what they take and refuse, which planes they make, and names that stay apart."""

import functools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.errors import InputError
from lfref.lightfield import LightField
from lfref.refocus.apertures import disc
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.through_cells import shift_and_sum_through_cells
from lfref.refocuser.operators import OperatorRefocuser
from lfref.refocuser.refocuser import check_for_network, in_bands, name_apart

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


CPU = torch.device("cpu")


def refocuser(**options):
    return OperatorRefocuser("shift_and_sum", functools.partial(shift_and_sum, **options))


def field(grid=(3, 5), size=(67, 21), seed=0, **more):
    return LightField(torch.rand(*grid, 3, *size, generator=torch.Generator().manual_seed(seed)), **more)


@given(
    slopes=st.lists(st.floats(-2.5, 2.5), min_size=1, max_size=4),
    n_rows=st.integers(1, 80),
    interpolation=st.sampled_from(["nearest", "linear", "cubic"]),
    border=st.sampled_from(["renormalize", "edge", "zero"]),
    fill=st.sampled_from([0.0, 0.5, 1.0]),
    seed=st.integers(0, 3),
)
@settings(deadline=None, max_examples=60)
def test_bands_are_equal_to_the_whole(slopes, n_rows, interpolation, border, fill, seed):
    light, planes = field(seed=seed), torch.tensor(slopes, dtype=torch.float64)
    local = refocuser(interpolation=interpolation, border=border, fill=fill, disparity=0.25)
    assert torch.equal(in_bands(local, light, planes, n_rows, np.zeros, CPU), local(light, planes))


def test_cameras_anywhere_and_apertures_have_bands_too():
    positions = torch.rand(3, 5, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) * 4 - 2
    planes = torch.tensor([-1.5, 0.5], dtype=torch.float64)
    for light in (field(), field(positions=positions)):
        local = refocuser(interpolation="cubic").through(functools.partial(disc, diameter=3.0))
        assert torch.equal(in_bands(local, light, planes, 9, np.zeros, CPU), local(light, planes))


@given(slope=st.floats(-2.5, 2.5), fill=st.sampled_from([0.0, 1.0]))
@settings(deadline=None, max_examples=30)
def test_what_lies_beyond_the_reach_counts_for_nothing(slope, fill):
    light, planes = field(), torch.tensor([slope], dtype=torch.float64)
    local = refocuser(interpolation="cubic", fill=fill)
    reach = local.reach(planes, light)
    changed = light.views.clone()
    changed[..., 33, :] += 1
    moved = (local(changed, planes) != local(light.views, planes)).any(-1).any(1)[0]
    rows = moved.nonzero().flatten()
    assert len(rows)
    assert int((rows - 33).abs().max()) <= reach


@pytest.mark.parametrize(
    "whole",
    [
        OperatorRefocuser("exact_fourier", exact_fourier),
        OperatorRefocuser("shift_and_sum_through_cells", shift_and_sum_through_cells),
        refocuser(border="wrap"),
        refocuser(interpolation="exact"),
        refocuser(fill=1.0, disparity=torch.zeros(67, 21)),
    ],
)
def test_what_looks_at_the_whole_picture_is_refused(whole):
    planes = torch.tensor([0.5], dtype=torch.float64)
    with pytest.raises(InputError, match=r"whole picture; take method=shift_and_sum"):
        in_bands(whole, field(), planes, 8, np.zeros, CPU)


def test_weights_of_samples_are_refused():
    light = field(weight=torch.ones(3, 5, 1, 67, 21))
    with pytest.raises(InputError, match="of samples with weights, which looks at the whole picture"):
        in_bands(refocuser(), light, torch.tensor([0.5], dtype=torch.float64), 8, np.zeros, CPU)


@pytest.mark.parametrize("ratio", [0.999, 1.001])
def test_one_sample_that_drowns_all_others_is_refused_and_named(ratio):
    views = torch.ones(3, 3, 3, 8, 8)
    views[2, 1, 0, 5, 7] = 1e6 * ratio
    if ratio < 1:
        check_for_network("net", views, None, views.device)
    else:
        with pytest.raises(InputError, match=r"\(2, 1, 0, 5, 7\)"):
            check_for_network("net", views, None, views.device)


def test_lights_on_black_are_no_such_sample():
    views = torch.zeros(3, 3, 3, 32, 32)
    views[:, :, :, 5, 7] = 1e9
    check_for_network("net", views, None, views.device)
