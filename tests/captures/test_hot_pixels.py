"""Hot pixels: those put onto a field are found and vanish, detail stays bit for bit."""

import dataclasses

import pytest
import torch

from lfref.captures import hot_pixels
from lfref.lightfield import LightField
from lfref.simulator.effects.mosaic import demosaicked, mosaicked

from .scenes import ODD, clean, estimates


def spots(shape, count):
    generator = torch.Generator().manual_seed(3)
    edge = (0, 0, 0, 1, 1)
    return tuple(torch.randint(e, n - e, (count,), generator=generator) for n, e in zip(shape, edge, strict=True))


@pytest.mark.parametrize("name", ["leaves", "gloss", "window", "running"])
def test_hot_and_dead_pixels_are_found_and_vanish(name):
    field = clean(name)
    views, places = field.views.clone(), spots(field.views.shape, 200)
    views[places] = torch.where(torch.arange(200) % 2 == 0, 1.0, 0.0)
    spoilt = LightField(views)
    found = hot_pixels.find(estimates(spoilt))
    corrected = found.corrected(spoilt).views
    before, after = ((each - field.views).square().sum() for each in (views, corrected))
    assert float(after) < 0.15 * float(before)
    is_touched = torch.zeros(views.shape, dtype=torch.bool)
    is_touched[found.samples.unbind(1)] = True
    assert torch.equal(corrected[~is_touched], views[~is_touched])


def test_what_a_mosaic_has_spread_goes_too():
    scene = clean("lamps").views
    raw = mosaicked(scene, "RGGB")
    hot = raw.clone()
    v, u, _, y, x = spots(raw.shape, 60)
    y, x = y.clamp(4, 120), x.clamp(4, 180)
    hot[v, u, 0, y, x] += 0.5
    field = LightField(demosaicked(hot, "RGGB"))
    found = hot_pixels.find(estimates(field))
    clean_views = demosaicked(raw, "RGGB")
    before, after = ((each - clean_views).square().sum() for each in (field.views, found.corrected(field).views))
    assert float(after) < 0.1 * float(before)


@pytest.mark.parametrize("name", [*ODD, "lattice", "wall", "stripes", "bokeh"])
def test_detail_is_left(name):
    assert hot_pixels.find(estimates(clean(name))).reason_to_skip() is not None


def test_noise_is_left():
    field = clean("shards")
    noisy = dataclasses.replace(field, views=field.views + 0.03 * torch.randn(field.views.shape))
    assert hot_pixels.find(estimates(noisy)).reason_to_skip() is not None


@pytest.mark.parametrize(
    "views", [torch.zeros(3, 3, 3, 40, 60), torch.rand(1, 1, 3, 40, 60), torch.rand(3, 3, 1, 5, 5)]
)
def test_where_no_view_confirms_or_nothing_is_to_be_seen_nothing_is_found(views):
    assert hot_pixels.find(estimates(LightField(views))).reason_to_skip() is not None
