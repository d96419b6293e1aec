"""Black views and corners weigh nothing and do not show; dark scenes keep all their views."""

import pytest
import torch

from lfref.captures import black_views
from lfref.io.read import read
from lfref.lightfield import LightField
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.operators import OperatorRefocuser

from .scenes import ODD, clean, estimates


def rounded(size, radius):
    """Where a round picture of this radius leaves corners black."""
    y, x = (torch.arange(length) - (length - 1) / 2 for length in size)
    return y[:, None].square() + x.square() > radius**2


def test_views_without_light_weigh_nothing_and_do_not_show():
    field = clean("shards")
    views = field.views.clone()
    for place in ((0, 0), (0, 6), (6, 0), (6, 6)):
        views[place] *= 0.01
    dark = LightField(views)
    found = black_views.find(estimates(dark))
    assert found.views == ((0, 0), (0, 6), (6, 0), (6, 6))
    assert "4 black views" in found.summary()
    weights = torch.ones(7, 7)
    weights[::6, ::6] = 0
    expected = shift_and_sum(field.views, [-0.4], weights=weights)
    got = OperatorRefocuser("sum", shift_and_sum)(found.corrected(dark), [-0.4])
    torch.testing.assert_close(got, expected, atol=1e-5, rtol=0)


def test_round_black_corners_of_all_views_weigh_nothing():
    field = clean("shards")
    black = rounded(field.size, 108)
    views = field.views.masked_fill(black, 0.0) + 0.002 * torch.rand(field.views.shape)
    found = black_views.find(estimates(LightField(views)))
    assert bool(found.corners[:, :, 0, black].all())
    share = float(found.corners.float().mean())
    assert float(black.float().mean()) < share < 1.8 * float(black.float().mean())
    corrected = found.corrected(LightField(views))
    assert torch.equal(corrected.weight == 0, found.corners)
    assert torch.equal(corrected.views, views)


@pytest.mark.parametrize("name", [*ODD, "bokeh", "everything"])
def test_a_field_with_light_everywhere_is_left(name):
    assert black_views.find(estimates(clean(name))).reason_to_skip() is not None


def test_a_dark_scene_is_left():
    views = 0.001 * torch.rand(5, 5, 3, 60, 80)
    views[..., 20:40, 30:50] = 0.8
    assert black_views.find(estimates(LightField(views))).reason_to_skip() is not None
    views[..., :20] = 0
    assert black_views.find(estimates(LightField(views))).reason_to_skip() is not None


def test_weights_that_are_there_stay():
    views = torch.rand(3, 3, 3, 20, 30)
    views[0, 1] = 0
    weight = torch.full((3, 3, 1, 20, 30), 0.5)
    weight[2, 2] = 0
    field = LightField(views, weight=weight)
    found = black_views.find(estimates(field))
    assert found.views == ((0, 1),)
    expected = weight.clone()
    expected[0, 1] = 0
    assert torch.equal(found.corrected(field).weight, expected)
    assert black_views.find(estimates(found.corrected(field))).reason_to_skip() is not None


@pytest.mark.parametrize("views", [torch.zeros(3, 3, 3, 40, 60), torch.rand(1, 1, 1, 1, 1), torch.rand(1, 4, 3, 2, 9)])
def test_fields_of_nothing_and_small_ones_are_left(views):
    assert black_views.find(estimates(LightField(views))).reason_to_skip() is not None


def test_the_corners_of_a_real_capture_are_found(lytro):
    field = read(lytro, encoding="linear")
    found = black_views.find(estimates(field))
    assert found.views == ()
    assert 0.015 < float(found.corners.float().mean()) < 0.03
    assert bool(found.corners[:, :, 0, [0, 0, -1, -1], [0, -1, 0, -1]].all())
    lit = field.views.amax(2, keepdim=True) > 0.03
    assert float((found.corners & lit).float().mean()) < 0.006
