"""Registration: patches have the scene's disparities, found once; too little to see is None."""

import dataclasses

import torch

from lfref.captures import registration
from lfref.captures.estimates import Estimates
from lfref.lightfield import LightField

from . import displaced


def test_patches_of_a_plane_have_its_disparity():
    found = displaced.estimates("plane").registration
    torch.testing.assert_close(
        found.explanation.disparities, torch.full_like(found.explanation.disparities, -1 / 3), atol=0.01, rtol=0
    )
    assert displaced.estimates("plane").registration is found
    assert sum(int(quarter.sum()) for quarter in found.quarters()) == len(found.patches.rows)


def test_quarters_without_patches_are_left_out():
    found = displaced.estimates("plane").registration
    falling = torch.arange(len(found.patches.rows))
    diagonal = found._replace(patches=found.patches._replace(rows=falling, columns=falling))
    quarters = diagonal.quarters()
    assert len(quarters) == 2
    assert bool((quarters[0] ^ quarters[1]).all())


def test_half_of_the_patches_say_the_same():
    found = displaced.estimates("shards").registration
    part = found.explain(registration.linear_shifts(found.positions), torch.arange(len(found.patches.rows)) % 2 == 0)
    assert float((part.shifts - found.explanation.shifts).abs().max()) < 0.02


def test_patches_are_shown_by_views_that_count_there():
    field = displaced.scene("plane")
    weight = torch.ones(7, 7, 1, *field.size)
    weight[0, 0] = 0
    weight[6, 6, :, :, :96] = 0
    found = Estimates(dataclasses.replace(field, weight=weight)).registration
    shown = found.observed.shown.unflatten(1, (7, 7))
    assert not shown[:, 0, 0].any()
    assert 0 < float(shown[:, 6, 6].mean()) < 1
    assert bool(shown[:, 3, 3].all())


def test_too_few_views_or_textures_are_nothing_to_register():
    for views in (torch.rand(1, 2, 3, 96, 96), torch.full((3, 3, 3, 96, 96), 0.5), torch.rand(5, 5, 3, 24, 24)):
        assert Estimates(LightField(views)).registration is None
