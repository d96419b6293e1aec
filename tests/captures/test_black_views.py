"""Black views and corners weigh nothing and do not show; dark scenes keep all their views."""

import pytest
import torch

from lfref.captures import black_views
from lfref.io.read import read
from lfref.lightfield import LightField
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.refocuser import OperatorRefocuser

from .scenes import ODD, clean


def outside_circle(size, radius):
    y, x = (torch.arange(length) - (length - 1) / 2 for length in size)
    return y[:, None].square() + x.square() > radius**2


def test_views_without_light_weigh_nothing_and_do_not_show():
    field = clean("shards")
    views = field.views.clone()
    views[::6, ::6] *= 0.01
    dark = LightField(views)
    defect = black_views.find(dark)
    assert defect.views == ((0, 0), (0, 6), (6, 0), (6, 6))
    assert "4 black views" in defect.summary()
    weights = torch.ones(7, 7)
    weights[::6, ::6] = 0
    expected = shift_and_sum(field.views, [-0.4], weights=weights)
    got = OperatorRefocuser("sum", shift_and_sum)(defect.corrected(dark), [-0.4])
    torch.testing.assert_close(got, expected, atol=1e-5, rtol=0)


@pytest.mark.parametrize(("light", "is_black"), [(0.04, True), (0.06, False)])
def test_a_view_with_a_twentieth_of_the_light_is_black(light, is_black):
    views = torch.full((3, 3, 1, 40, 40), 0.5)
    views[2, 1] *= light
    assert (black_views.find(LightField(views)).views == ((2, 1),)) == is_black


def test_round_black_corners_of_all_views_weigh_nothing():
    field = clean("shards")
    black = outside_circle(field.size, 108)
    views = field.views.masked_fill(black, 0.0) + 0.002 * torch.rand(field.views.shape)
    defect = black_views.find(LightField(views))
    assert bool(defect.corners[:, :, 0, black].all())
    share = float(defect.corners.float().mean())
    assert float(black.float().mean()) < share < 1.8 * float(black.float().mean())
    corrected = defect.corrected(LightField(views))
    assert torch.equal(corrected.weight == 0, defect.corners)
    assert torch.equal(corrected.views, views)


@pytest.mark.parametrize(
    ("side", "light", "is_black"),
    [(10, 0.015, True), (10, 0.025, False), (1, 0.0, False), (2, 0.0, True), (34, 0.0, True), (42, 0.0, False)],
)
def test_corners_below_a_fiftieth_of_the_light_from_2_pixels_to_two_fifths_of_a_side_are_black(side, light, is_black):
    near = torch.minimum(torch.arange(100), torch.arange(99, -1, -1))
    views = torch.ones(2, 2, 1, 100, 100).masked_fill(near[:, None] + near < side, light)
    assert (black_views.find(LightField(views)).corners is not None) == is_black


@pytest.mark.parametrize("name", [*ODD, "bokeh"])
def test_a_field_with_light_everywhere_is_left(name):
    assert black_views.find(clean(name)).reason_to_skip() is not None


def test_a_dark_scene_is_left():
    views = 0.001 * torch.rand(5, 5, 3, 60, 80)
    views[..., 20:40, 30:50] = 0.8
    assert black_views.find(LightField(views)).reason_to_skip() is not None
    views[..., :20] = 0
    assert black_views.find(LightField(views)).reason_to_skip() is not None


def test_weights_of_the_light_field_stay():
    views = torch.rand(3, 3, 3, 20, 30)
    views[0, 1] = 0
    weight = torch.full((3, 3, 1, 20, 30), 0.5)
    weight[2, 2] = 0
    field = LightField(views, weight=weight)
    defect = black_views.find(field)
    assert defect.views == ((0, 1),)
    expected = weight.clone()
    expected[0, 1] = 0
    assert torch.equal(defect.corrected(field).weight, expected)
    assert black_views.find(defect.corrected(field)).reason_to_skip() is not None


@pytest.mark.parametrize("views", [torch.zeros(3, 3, 3, 40, 60), torch.rand(1, 4, 3, 2, 9)])
def test_black_fields_and_small_ones_are_left(views):
    assert black_views.find(LightField(views)).reason_to_skip() is not None


def test_the_corners_of_a_real_capture_are_found(lytro):
    field = read(lytro, encoding="linear")
    defect = black_views.find(field)
    assert defect.views == ()
    assert 0.015 < float(defect.corners.float().mean()) < 0.03
    assert bool(defect.corners[:, :, 0, [0, 0, -1, -1], [0, -1, 0, -1]].all())
    lit = field.views.amax(2, keepdim=True) > 0.03
    assert float((defect.corners & lit).float().mean()) < 0.006
