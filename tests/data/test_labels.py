"""A label is what its operator makes of the field, and the margin is what a local operator depends on."""

import dataclasses
import functools

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.data.labels import LabelSource
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus import weighted
from lfref.refocus.exact_fourier import exact_fourier
from lfref.refocus.shift_and_sum import shift_and_sum

PLANES = FocalPlanes((0.4, 1.0, 2.0))


def test_a_label_is_the_operator_at_the_slopes_of_its_planes():
    field = LightField(torch.rand(3, 3, 3, 12, 13))
    for operator in (shift_and_sum, exact_fourier, functools.partial(shift_and_sum, border="zero")):
        label = LabelSource("name", operator, PLANES)(field)
        assert torch.equal(label, operator(field.views, PLANES.slopes))
        assert label.shape == (3, 3, 12, 13)


def test_the_weight_of_samples_is_respected():
    field = LightField(torch.rand(3, 3, 3, 12, 13), weight=torch.rand(3, 3, 1, 12, 13))
    label = LabelSource("name", shift_and_sum, PLANES)(field)
    assert torch.equal(label, weighted.refocus(shift_and_sum, field, PLANES.slopes))
    assert not torch.allclose(label, shift_and_sum(field.views, PLANES.slopes))


@pytest.mark.parametrize(
    ("alphas", "grid", "margin"),
    [((0.125, 2.0), (7, 7), 22), ((1.0,), (7, 7), 1), ((2.0,), (7, 7), 3), ((2.0,), (3, 9), 3), ((0.5,), (1, 1), 1)],
)
def test_the_margin_by_hand(alphas, grid, margin):
    assert LabelSource("name", shift_and_sum, FocalPlanes(alphas)).margin(grid) == margin


@given(alpha=st.floats(0.2, 4.0))
@settings(max_examples=25, deadline=None)
def test_nothing_beyond_the_margin_touches_a_label(alpha):
    source = LabelSource("name", shift_and_sum, FocalPlanes((alpha,)))
    margin = source.margin((3, 3))
    length = 2 * margin + 5
    views = torch.rand(3, 3, 1, length, length)
    poisoned = torch.full((3, 3, 1, length + 4, length + 4), torch.nan)
    poisoned[..., 2:-2, 2:-2] = views
    label = source(LightField(poisoned))[..., 2 + margin : -2 - margin, 2 + margin : -2 - margin]
    assert bool(label.isfinite().all())


def test_a_field_too_small_for_its_planes_is_refused():
    with pytest.raises(InputError, match="half the height"):
        LabelSource("name", shift_and_sum, FocalPlanes((0.125,)))(LightField(torch.rand(7, 7, 1, 42, 60)))


def test_a_source_cannot_be_changed():
    source = LabelSource("name", shift_and_sum, PLANES)
    with pytest.raises(dataclasses.FrozenInstanceError):
        source.name = "other"
