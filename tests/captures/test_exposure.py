"""Exposure: gains of views and colours come back; views that differ by what they show keep theirs."""

import dataclasses

import pytest
import torch

from lfref.captures import exposure
from lfref.captures.exposure import ExposureDefect
from lfref.lightfield import LightField

from .scenes import ODD, clean, estimates


@pytest.mark.parametrize("name", ["shards", "gloss", "leaves"])
def test_gains_of_views_and_colours_come_back(name):
    field, gains = clean(name), torch.exp(0.1 * torch.randn(7, 7, 3))
    gains[3, 3] = 1
    changed = dataclasses.replace(field, views=0.6 * field.views * gains[..., None, None])
    found = exposure.find(estimates(changed))
    error = (found.gains / gains - 1).abs()
    assert float(error.median()) < 0.003
    assert float(error.max()) < 0.015
    restored = found.corrected(changed).views / (0.6 * field.views).clamp(min=1e-3)
    assert float((restored.mean((3, 4)) - 1).abs().median()) < 0.003


def test_one_bright_view_is_the_only_one_that_changes():
    field = clean("shards")
    views = field.views.clone()
    views[1, 5] *= 1.06
    changed = LightField(views)
    found = exposure.find(estimates(changed))
    corrected = found.corrected(changed).views
    others = [(v, u) for v in range(7) for u in range(7) if (v, u) != (1, 5)]
    assert all(torch.equal(corrected[place], field.views[place]) for place in others)
    torch.testing.assert_close(corrected[1, 5], field.views[1, 5], rtol=0.003, atol=0)
    assert "1 of 49 views are 1.000 to 1.0" in found.summary()


@pytest.mark.parametrize("name", [*ODD, "lattice", "floor"])
def test_a_field_of_equal_exposures_is_left(name):
    assert exposure.find(estimates(clean(name))).reason_to_skip() is not None


def test_a_black_view_is_no_matter_of_exposure():
    views = clean("shards").views.clone()
    views[0, 0] *= 0.01
    assert bool((exposure.find(estimates(LightField(views))).gains[0, 0] == 1).all())


@pytest.mark.parametrize("views", [torch.zeros(3, 3, 3, 40, 60), torch.rand(1, 1, 3, 40, 60)])
def test_where_nothing_is_to_be_compared_nothing_is_found(views):
    assert exposure.find(estimates(LightField(views))).reason_to_skip() is not None


def test_integers_of_a_gain_are_exact():
    found = ExposureDefect(torch.full((2, 2, 3), 2.0, dtype=torch.float64), 0.001)
    field = LightField(torch.full((2, 2, 3, 4, 4), 0.5))
    assert torch.equal(found.corrected(field).views, torch.full((2, 2, 3, 4, 4), 0.25))
