"""Brightness from view to view: gains that are put on come back, what is not known is told."""

import dataclasses

import torch

from lfref.captures import brightness
from lfref.lightfield import LightField

from .scenes import clean, estimates


def test_gains_come_back_as_logarithms():
    field = clean("shards")
    gains = 1 + 0.2 * torch.rand(7, 7, 3)
    gains[3, 3] = 1
    dimmer = dataclasses.replace(field, views=0.7 * field.views * gains[..., None, None])
    reference = clean("shards")
    one, other = (estimates(each).ratios for each in (dimmer, reference))
    both = one.known & other.known
    assert float(both.float().mean()) > 0.8
    change = (one.log - other.log - gains.log()[..., None]).abs().amax(2)[both]
    # Disparities are found anew, so that windows lie a little elsewhere.
    assert float(change.median()) < 0.003


def test_equal_views_are_equally_bright():
    found = estimates(LightField(0.9 * torch.rand(3, 64, 96).expand(5, 5, -1, -1, -1).clone())).ratios
    assert found.shape == (5, 8)
    assert float(found.log[found.known[:, :, None].expand_as(found.log)].abs().max()) < 0.01


def test_clipped_windows_and_closed_views_are_not_known():
    views = 0.5 + 0.2 * torch.rand(3, 64, 96).expand(3, 3, -1, -1, -1).clone()
    views[..., :12, :12] = 1.0
    weight = torch.ones(3, 3, 1, 64, 96)
    weight[0, 2] = 0
    found = brightness.ratios(LightField(views, weight=weight), torch.zeros(64, 96), (1, 1))
    assert not bool(found.known[..., 0].any())
    assert not bool(found.known[0, 2].any())
    # The windows beside it may read a hair beyond their edge.
    assert bool(found.known[1].unflatten(1, found.shape)[:, 2:, 2:].all())


def test_windows_are_placed_where_the_views_show_them():
    views = 0.5 + 0.1 * torch.rand(5, 5, 3, 64, 96)
    found = brightness.ratios(LightField(views), torch.full((64, 96), 0.5), (2, 2))
    half_diagonal = (64**2 + 96**2) ** 0.5 / 2
    y, x = found.places
    torch.testing.assert_close(y[4] - y[2], torch.full_like(y[4], 0.5 * 2 / half_diagonal))
    torch.testing.assert_close(x[:, 0] - x[:, 2], torch.full_like(x[:, 0], -0.5 * 2 / half_diagonal))
    assert float(y[2, 2, 0]) == float(torch.tensor((6 - 32) / half_diagonal))
