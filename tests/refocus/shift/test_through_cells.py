"""Shift-and-sum through cells: points among the scene's disparities, cells beyond, and nearer the truth for it."""

import dataclasses

import pytest
import torch

from lfref.refocus.disparity.disparity_range import DisparityRange
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.through_cells import shift_and_sum_through_cells, widths
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate


def test_planes_among_the_disparities_stay_points():
    disparities = DisparityRange(-1.0, -0.4, 0.4)
    planes = torch.tensor([-7.0, -3.0, -1.0, 0.0, 0.4, 0.55])
    assert widths(planes, disparities).tolist() == pytest.approx([6.6, 2.6, 0, 0, 0, 0])


def test_half_way_through_a_fade_a_box_is_half_as_wide():
    by_range = widths(torch.tensor([0.15, 0.3]), DisparityRange(-3.0, -2.0, 0.0))
    assert by_range.tolist() == pytest.approx([2.15 / 2, 2.3])
    by_blur = widths(torch.tensor([1.15, 1.3]), DisparityRange(0.0, 0.0, 0.0))
    assert by_blur.tolist() == pytest.approx([1.15 / 2, 1.3])


def test_cells_fade_in():
    disparities = DisparityRange(0.0, 0.0, 0.0)
    planes = torch.linspace(0.9, 1.5, 61, dtype=torch.float64)
    steps = widths(planes, disparities).diff()
    assert bool((steps >= 0).all())
    assert float(steps.max()) < 0.06


def test_it_is_cubic_shift_and_sum_where_nothing_moves():
    views = torch.rand(1, 1, 3, 32, 40).expand(5, 5, 3, 32, 40)
    slopes = [-0.5, 0.25]
    assert torch.equal(shift_and_sum_through_cells(views, slopes), shift_and_sum(views, slopes, "cubic"))


def test_each_light_field_of_a_batch_has_its_own_range():
    views = torch.rand(2, 5, 5, 3, 32, 40)
    both = shift_and_sum_through_cells(views, [-2.5, 0.0])
    for stack, field in zip(both, views, strict=True):
        assert torch.equal(stack, shift_and_sum_through_cells(field, [-2.5, 0.0]))


@pytest.mark.parametrize("name", ["edge", "discs", "twigs"])
def test_wide_blur_has_no_copies(name):
    scene = dataclasses.replace(sim30.SCENES[name], sensor=sim30.IDEAL)
    made = simulate(scene, slopes=[-7.0, -3.0])
    inner = (..., slice(24, -24), slice(24, -24))

    def error(stack: torch.Tensor) -> torch.Tensor:
        return (stack - made.truth)[inner].square().mean((1, 2, 3))

    points, cells = shift_and_sum(made.views, made.slopes), shift_and_sum_through_cells(made.views, made.slopes)
    assert bool((error(cells) < error(points) / 8).all())  # 9 dB
