"""Registration: patches have the scene's disparities, found once; too little to see is None."""

import dataclasses

import torch

from lfref.captures import registration
from lfref.captures.defect import Evidence
from lfref.lightfield import LightField

from . import displaced


def test_patches_of_a_plane_have_its_disparity():
    found = registration.registered(displaced.evidence("plane"))
    torch.testing.assert_close(
        found.solved.disparities, torch.full_like(found.solved.disparities, -1 / 3), atol=0.01, rtol=0
    )
    assert registration.registered(displaced.evidence("plane")) is found
    assert sum(int(quarter.sum()) for quarter in found.quarters()) == len(found.patches.rows)


def test_quarters_without_patches_are_left_out():
    found = registration.registered(displaced.evidence("plane"))
    falling = torch.arange(len(found.patches.rows))
    diagonal = found._replace(patches=found.patches._replace(rows=falling, columns=falling))
    quarters = diagonal.quarters()
    assert len(quarters) == 2
    assert bool((quarters[0] ^ quarters[1]).all())


def test_half_of_the_patches_say_the_same():
    found = registration.registered(displaced.evidence("shards"))
    part = found.again(registration.linear(found.places), torch.arange(len(found.patches.rows)) % 2 == 0)
    assert float((part.shifts - found.solved.shifts).abs().max()) < 0.02


def test_patches_are_shown_by_views_that_count_there():
    field = displaced.scene("plane")
    weight = torch.ones(7, 7, 1, *field.size)
    weight[0, 0] = 0
    weight[6, 6, :, :, :96] = 0
    found = registration.registered(Evidence(dataclasses.replace(field, weight=weight)))
    shown = found.seen.shown.unflatten(1, (7, 7))
    assert not shown[:, 0, 0].any()
    assert 0 < float(shown[:, 6, 6].mean()) < 1
    assert bool(shown[:, 3, 3].all())


def test_too_few_views_or_textures_are_nothing_to_register():
    for views in (torch.rand(1, 2, 3, 96, 96), torch.full((3, 3, 3, 96, 96), 0.5), torch.rand(5, 5, 3, 24, 24)):
        assert registration.registered(Evidence(LightField(views))) is None
