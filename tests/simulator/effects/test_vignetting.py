"""Vignetting: the axis is bright, the corners follow cos^4, and the clipped pupil is the overlap of rim and grid."""

import math

import pytest
import torch

from lfref.simulator.effects.optics import Vignetting, clipped_pupil, falloff


def blank(*shape):
    return torch.ones(shape, dtype=torch.float64)


def test_the_axis_keeps_its_light_in_every_view():
    views = torch.rand(3, 5, 3, 7, 9)
    result = Vignetting(2.0, 1.5).apply(views, torch.Generator())
    assert torch.equal(result[..., 3, 4], views[..., 3, 4])
    assert bool((result <= views).all())


@pytest.mark.parametrize("field", [0.2, 1.0])
def test_light_falls_off_with_the_fourth_power_of_the_cosine(field):
    gain = falloff(blank(1, 1, 3, 6, 8), field)
    for row, column in ((0, 0), (2, 5), (5, 7)):
        tangent = field * math.hypot(row - 2.5, column - 3.5) / 5
        assert float(gain[row, column]) == pytest.approx(math.cos(math.atan(tangent)) ** 4)


def test_views_on_the_far_side_of_the_pixel_are_clipped_first():
    gain = clipped_pupil(blank(5, 5, 3, 9, 9), 1.0)[2, :, 0, 4, -1]
    assert float(gain[-1]) == 1
    assert bool((gain.diff() >= 0).all())
    assert float(gain[0]) < 1


@pytest.mark.parametrize("displacement", [0.3, 0.8, 1.4])
def test_what_gets_through_is_the_overlap_of_rim_and_grid(displacement):
    n_views, shape = 40, (3, 3, 3)
    gain = clipped_pupil(blank(n_views, n_views, *shape), displacement)
    radius = n_views / math.sqrt(2)
    points = (torch.arange(8 * n_views, dtype=torch.float64) + 0.5) / 8 - n_views / 2
    for row, column in ((0, 0), (1, 0), (2, 2)):
        y, x = (displacement * radius * place / (1.5 * math.sqrt(2)) for place in (row - 1, column - 1))
        inside = (points[:, None] - y) ** 2 + (points - x) ** 2 <= radius**2
        assert float(gain[:, :, 0, row, column].mean()) == pytest.approx(float(inside.double().mean()), abs=2e-3)
