"""Bands of rows make the whole picture to the bit, or say why they cannot."""

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
from lfref.refocuser.refocuser import in_bands

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
