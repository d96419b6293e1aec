"""Comparisons show the right planes of every method, all with one gain."""

import pytest
import torch

from lfref import geometry
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.report import comparison
from tests.report.test_pictures import PAPER, H, W, screen, stack


def images(figure):
    return [(axes.get_title(), axes.images[0].get_array()) for axes in figure.axes if axes.images]


@pytest.mark.parametrize(
    ("planes", "shown"),
    [
        (PAPER, [0, 7, 15]),
        (geometry.planes_at_alphas([0.5, 0.9, 1.4]), [0, 1, 2]),
        (geometry.planes_at_alphas([2.0, 0.4]), [1, 0]),
        (FocalPlanes([3.0, 0.2, -2.0, 1.0]), [2, 1, 0]),
        (FocalPlanes([1.0]), [0]),
    ],
)
def test_the_ends_and_the_plane_nearest_to_slope_0_are_shown_and_each_only_once(planes, shown):
    assert comparison.ends_and_middle(planes) == shown


@pytest.mark.parametrize(
    ("planes", "titles"),
    [
        (geometry.planes_at_alphas([0.2, 0.9, 1.9]), ["alpha 0.2", "alpha 0.9", "alpha 1.9"]),
        (FocalPlanes([-4, 0.1, 0.5]), ["slope -4", "slope 0.1", "slope 0.5"]),
    ],
)
def test_comparison_shows_three_planes_with_the_mean_in_the_middle(planes, titles):
    stacks = {name: stack(3) * 10 for name in ("first", "second", "third", "fourth")}
    figure = comparison.comparison(stacks, planes, torch.full((3, H, W), 0.09))
    shown = images(figure)
    row = list(zip(titles, (0.0, 1.0, 1.0), strict=True))
    expected = [*row, *row, ("mean of all views, not refocused", 0.9), *row, *row]
    assert [title for title, _ in shown] == [title for title, _ in expected]
    assert [float(array.max()) for _, array in shown] == pytest.approx([screen(value) for _, value in expected])
    assert [axes.get_ylabel() for axes in figure.axes[::3]] == ["first", "second", "", "third", "fourth"]


def test_a_brighter_method_stays_brighter():
    mean, planes = torch.full((1, H, W), 0.09), FocalPlanes([0.0])
    shown = images(comparison.comparison({"a": stack(8)[7:], "b": stack(8, gain=0.5)[7:]}, planes, mean))
    (_, a), (_, middle), (_, b) = shown
    assert [float(a.mean()), float(middle.mean()), float(b.mean())] == pytest.approx(
        [screen(light) for light in (0.7, 0.9, 0.35)], rel=1e-5
    )


def test_a_stack_that_does_not_fit_the_planes_is_named():
    with pytest.raises(InputError, match=r"'net'.*N = 16"):
        comparison.comparison({"net": stack(4)}, PAPER, torch.zeros(3, H, W))
    with pytest.raises(InputError, match="at least one method"):
        comparison.comparison({}, PAPER, torch.zeros(3, H, W))
