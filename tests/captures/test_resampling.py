"""Resampling: as the simulator's matrices do it, and weights that stay weights."""

import dataclasses

import torch

from lfref import geometry
from lfref.captures import resampling
from lfref.lightfield import LightField


def test_views_are_resampled_as_by_the_simulator():
    views = torch.rand(2, 3, 3, 20, 33, dtype=torch.float64)
    rows = geometry.angular_offsets(20) * 1.02 + torch.rand(2, 3, 1, 1, dtype=torch.float64)
    columns = geometry.angular_offsets(33) - 3 * torch.rand(2, 3, 3, 1, dtype=torch.float64)
    expected = displacement.resample(views, rows.expand(2, 3, 3, 20), columns)
    torch.testing.assert_close(resampling.resample_views(views, rows, columns), expected, atol=1e-12, rtol=0)


def test_whole_positions_keep_samples():
    views = torch.rand(1, 1, 1, 9, 12)
    rows, columns = resampling.centred((9, 12))
    assert torch.equal(resampling.resample_views(views, rows, columns), views)
    assert torch.equal(resampling.resample_views(views, rows, columns + 2)[..., :-2], views[..., 2:])


def test_weights_move_along_and_stay_between_0_and_1():
    weight = (torch.rand(2, 2, 1, 24, 24) > 0.5).float()
    field = LightField(torch.rand(2, 2, 3, 24, 24), weight=weight)
    rows, columns = resampling.centred((24, 24))
    moved = resampling.resample_field(field, rows + 0.4, columns)
    assert float(moved.weight.min()) >= 0
    assert float(moved.weight.max()) <= 1
    even = dataclasses.replace(field, weight=torch.ones_like(weight))
    torch.testing.assert_close(resampling.resample_field(even, rows + 0.4, columns).weight, even.weight)
