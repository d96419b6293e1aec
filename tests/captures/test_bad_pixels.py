"""Hot pixels, black views and black corners: known ones are found and corrected; all else stays bit for bit."""

import dataclasses
import itertools

import pytest
import torch
from torch.nn import functional as F

from lfref.captures import bad_pixels
from lfref.lightfield import LightField
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator.effects.recording import demosaicked, mosaicked

from .scenes import ODD, clean, view


def found_in(field):
    return bad_pixels.find_hot(field, **view(field))


def spots(shape, count):
    generator = torch.Generator().manual_seed(3)
    edge = (0, 0, 0, 1, 1)
    return tuple(torch.randint(e, n - e, (count,), generator=generator) for n, e in zip(shape, edge, strict=True))


@pytest.mark.parametrize("name", ["leaves", "gloss"])
def test_hot_and_dead_pixels_are_found_and_replaced(name):
    field = clean(name)
    views, places = field.views.clone(), spots(field.views.shape, 200)
    views[places] = torch.where(torch.arange(200) % 2 == 0, 1.0, 0.0)
    spoilt = LightField(views)
    defect = found_in(spoilt)
    corrected = defect.corrected(spoilt).views
    before, after = ((changed - field.views).square().sum() for changed in (views, corrected))
    assert float(after) < 0.15 * float(before)
    is_replaced = torch.zeros(views.shape, dtype=torch.bool)
    is_replaced[defect.samples.unbind(1)] = True
    assert torch.equal(corrected[~is_replaced], views[~is_replaced])


def test_samples_that_a_mosaic_has_spoilt_are_replaced_too():
    raw = mosaicked(clean("lamps").views, "RGGB")
    hot = raw.clone()
    v, u, _, y, x = spots(raw.shape, 60)
    y, x = y.clamp(4, 120), x.clamp(4, 180)
    hot[v, u, 0, y, x] += 0.5
    field, expected = LightField(demosaicked(hot, "RGGB")), demosaicked(raw, "RGGB")
    before, after = ((one.views - expected).square().sum() for one in (field, found_in(field).corrected(field)))
    assert float(after) < 0.1 * float(before)


@pytest.mark.parametrize("name", [*ODD, "stripes"])
def test_detail_and_noise_are_left_and_no_view_is_black(name):
    field = clean(name)
    noisy = dataclasses.replace(field, views=field.views + 0.03 * torch.randn(field.views.shape))
    assert found_in(field) == found_in(noisy) == bad_pixels.CONFIRMED
    assert isinstance(bad_pixels.find_black(field), str)


@pytest.mark.parametrize(
    "views", [torch.zeros(3, 3, 3, 40, 60), torch.rand(1, 2, 3, 40, 60), torch.rand(1, 4, 3, 2, 9)]
)
def test_black_and_small_fields_are_left(views):
    assert found_in(LightField(views)) == bad_pixels.CONFIRMED
    assert isinstance(bad_pixels.find_black(LightField(views)), str)


def decided(n, height=1.0, confirmed=0.0, detail=0.0, error=0.0):
    """Whether n samples of this height are hot, in surroundings of this range and this disagreement of other views."""
    own, others = torch.zeros(n, 7, 7), torch.zeros(n, 7, 7)
    own[:, 3, 3] = height
    others[:, 3, 4] = confirmed
    own[:, 0, 0] = detail
    others[:, 0, 0] = detail
    others[:, 0, 1] = error
    return bad_pixels.is_unconfirmed(own, others, torch.full((n,), height))


@pytest.mark.parametrize(
    ("surroundings", "expected"),
    [
        ({"confirmed": 0.45}, True),  # half of the height
        ({"confirmed": 0.55}, False),
        ({"detail": 1 / 1.4, "error": 9.0}, True),  # 1.3 times the range of the surroundings
        ({"detail": 1 / 1.2, "error": 9.0}, False),
        ({"detail": 9.0, "error": 1 / 1.6}, True),  # 1.5 times the disagreement of other views
        ({"detail": 9.0, "error": 1 / 1.4}, False),
    ],
)
def test_a_sample_is_hot_if_other_views_lack_it_and_it_exceeds_detail_or_disagreement(surroundings, expected):
    assert decided(10, **surroundings).tolist() == [expected] * 10


def spot(top, beside, colour=1.0):
    """Surroundings of a spot in three channels, [3, 1, 7, 7]: its top, and the mean of the samples beside it."""
    shape = torch.zeros(7, 7)
    shape[3, 3] = top
    shape[3, 2] = shape[3, 4] = shape[2, 3] = shape[4, 3] = beside
    return 0.2 + torch.tensor([colour, 0, 0])[:, None, None, None] * shape


@pytest.mark.parametrize(
    ("others", "is_single"),
    [
        (spot(0.0, 0.0), True),  # no other colour sticks out
        (spot(0.4, 0.1), False),  # a glint: another colour has the same shape
        (spot(0.06, 0.0), True),  # .12 of the height
        (spot(0.1, 0.02), False),  # .16
        (spot(0.4, 0.0), True),  # a mosaic spreads the hot colour alone, here by .2 times .8 of the height
        (spot(0.4, 0.055), True),  # the spreads differ by .09 of the height
        (spot(0.4, 0.065), False),  # .07
    ],
)
def test_a_photosite_has_one_colour(others, is_single):
    colours = spot(0.5, 0.125) + others.roll(1, 0) - 0.2
    assert bad_pixels.is_of_one_colour(colours).tolist() == [is_single]


def test_points_of_one_colour_are_confirmed_at_a_disparity_that_the_map_lacks():
    views = 0.5 + 0.001 * torch.rand(5, 5, 3, 40, 60)
    for v, u in itertools.product(range(5), repeat=2):
        views[v, u, 2, 14 + 2 * v, 24 + 2 * u] = 1.0
    # The map has disparities from 1 to 1.5 elsewhere, not at the points.
    disparity = torch.full((40, 60), 1.0)
    disparity[0] = 1.5
    assert bad_pixels.find_hot(LightField(views), disparity, (2, 2)) == bad_pixels.CONFIRMED
    # The points are hot pixels where no disparity of the scene explains them.
    assert bad_pixels.find_hot(LightField(views), disparity - 3, (2, 2)).count == 25


def outside_circle(size, radius):
    y, x = (torch.arange(length) - (length - 1) / 2 for length in size)
    return y[:, None].square() + x.square() > radius**2


def test_views_without_light_weigh_nothing_and_do_not_show():
    field = clean("shards")
    views = field.views.clone()
    views[::6, ::6] *= 0.01
    dark = LightField(views)
    defect = bad_pixels.find_black(dark)
    assert defect.views == ((0, 0), (0, 6), (6, 0), (6, 6))
    assert "4 black views" in defect.summary()
    weights = torch.ones(7, 7)
    weights[::6, ::6] = 0
    expected = shift_and_sum(field.views, [-0.4], weights=weights)
    got = OperatorRefocuser("sum", shift_and_sum)(defect.corrected(dark), [-0.4])
    torch.testing.assert_close(got, expected, atol=1e-5, rtol=0)


def test_round_black_corners_of_all_views_weigh_nothing():
    field = clean("shards")
    black = outside_circle(field.size, 108)
    views = field.views.masked_fill(black, 0.0) + 0.002 * torch.rand(field.views.shape)
    defect = bad_pixels.find_black(LightField(views))
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
    assert isinstance(bad_pixels.find_black(LightField(views)), bad_pixels.BlackViewsDefect) == is_black


def test_a_dark_scene_is_left():
    views = 0.001 * torch.rand(5, 5, 3, 60, 80)
    views[..., 20:40, 30:50], views[..., :20] = 0.8, 0
    assert isinstance(bad_pixels.find_black(LightField(views)), str)


def test_heights_are_those_over_the_largest_or_under_the_smallest_of_the_eight_around():
    images = torch.rand(3, 13, 22)
    heights = torch.stack([bad_pixels.heights_of(image) for image in images])
    windows = F.unfold(images[:, None], 3).unflatten(2, (11, 20))
    middle, around = windows[:, 4], windows[:, [0, 1, 2, 3, 5, 6, 7, 8]]
    expected = torch.maximum(middle - around.amax(1), around.amin(1) - middle)
    torch.testing.assert_close(heights, expected)
