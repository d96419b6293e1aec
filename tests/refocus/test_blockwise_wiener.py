"""Filters for all disparities and for those of blocks together: far from focus the ones, near it the others."""

from unittest import mock

import pytest
import torch

from lfref.errors import InputError
from lfref.refocus.blockwise_wiener import blockwise_wiener
from lfref.refocus.disparity.disparity_map import disparity_map
from lfref.refocus.focus.slope_range import DisparityRange
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.separable_wiener import separable_wiener
from lfref.refocus.shift.shift_and_sum_antialiased import shift_and_sum_antialiased
from tests.refocus.lens_scenes import SLOPES, psnr, scene


@pytest.mark.parametrize("name", ["edge", "discs"])
def test_is_nearer_the_truth_than_exact_refocusing(name):
    views, truth = scene(name)
    ours, exact = (psnr(operator(views, SLOPES), truth) for operator in (blockwise_wiener, exact_fourier))
    assert bool((ours >= exact - 0.1).all())
    assert float((ours - exact).mean()) > 4


def test_near_focus_in_a_wide_range_filters_of_all_views_together_help():
    views, truth = scene("deep")
    ours, cells = (psnr(operator(views, SLOPES), truth) for operator in (blockwise_wiener, shift_and_sum_antialiased))
    with mock.patch.object(DisparityRange, "is_wide", False):
        blind = psnr(blockwise_wiener(views, SLOPES), truth)
    for other in (cells, blind):
        assert float((ours - other)[SLOPES.index(0.4)]) > 2


@pytest.mark.parametrize(("name", "gain"), [("discs", 2), ("leaves", 0.8)])
def test_blocks_help_near_focus(name, gain):
    views, truth = scene(name)
    ours, everywhere = (psnr(operator(views, SLOPES), truth) for operator in (blockwise_wiener, separable_wiener))
    assert bool((ours >= everywhere - 2).all())  # beyond 65 dB
    assert float((ours - everywhere)[SLOPES.index(0.4)]) > gain


def test_gradients_reach_all_views():
    views = scene("edge")[0][1:6, 1:6, :1, 10:50, 30:70].double().requires_grad_()
    blockwise_wiener(views, [0.3]).square().mean().backward()
    assert bool(views.grad.isfinite().all())
    assert bool(views.grad.abs().amax((2, 3, 4)).gt(0).all())


def test_known_disparities_take_the_place_of_estimated_ones():
    views, _ = scene("discs")
    known = disparity_map(views).disparity
    stack = blockwise_wiener(views, SLOPES, disparities=known)
    torch.testing.assert_close(stack, blockwise_wiener(views, SLOPES), atol=2e-2, rtol=0)
    # Where everything is far from focus, no block counts.
    far = blockwise_wiener(views, [-3.4], disparities=torch.zeros_like(known))
    torch.testing.assert_close(far, separable_wiener(views, [-3.4]))


@pytest.mark.parametrize("operator", [blockwise_wiener, separable_wiener])
@pytest.mark.parametrize("change", [{"slopes": [20.0]}, {"weights": torch.arange(9.0).reshape(3, 3)}, {"views": None}])
def test_bad_arguments_are_refused(operator, change):
    views = torch.rand(3, 3, 1, 32, 32)
    if "views" in change:
        views[0, 1, 0, 5, 6] = torch.nan
    with pytest.raises(InputError):
        operator(**({"slopes": [0.3]} | change | {"views": views}))
