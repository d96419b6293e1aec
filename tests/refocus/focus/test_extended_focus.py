"""The picture that is sharp everywhere: the central view with less noise, edges and borders included."""

import math

import pytest
import torch

from lfref.errors import InputError
from lfref.functional import neighbours
from lfref.functional.psnr import psnr
from lfref.refocus.focus.all_in_focus import all_in_focus
from lfref.refocus.focus.extended_focus import extended_focus
from lfref.refocus.fourier.exact import exact_fourier
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate
from tests.refocus.conftest import shifted_views, texture


@pytest.mark.parametrize("name", ["leaves", "lattice"])
def test_noise_goes_and_what_it_hid_stays_borders_included(name):
    made = simulate(sim30.SCENES[name], outputs=["views", "all_in_focus"])
    noisy = made.views + 0.02 * torch.randn(made.views.shape, generator=torch.Generator().manual_seed(1))
    sharp, truth = extended_focus(noisy), made.all_in_focus
    stack = exact_fourier(noisy, torch.linspace(-1.2, 0.6, 19, dtype=torch.float64))
    assert float(psnr(sharp, truth)) > float(psnr(noisy[3, 3], truth)) + 5
    assert float(psnr(sharp, truth)) > float(psnr(all_in_focus(stack).image, truth)) + 5


@pytest.mark.parametrize(("disparity", "grid"), [(0.5, (5, 5)), (-0.7, (4, 3)), (1.0, (1, 5))])
def test_a_plane_at_a_known_disparity_is_the_view_in_the_middle(disparity, grid):
    picture = neighbours.smoothed(texture(3, 40, 44), 1.0)
    sharp = extended_focus(shifted_views(picture, disparity, grid), torch.full((40, 44), disparity))
    torch.testing.assert_close(sharp[:, 6:-6, 6:-6], picture[:, 6:-6, 6:-6], atol=0.01, rtol=0)


def test_a_view_of_weight_0_does_not_count():
    views, weights = shifted_views(texture(1, 32, 36), 0.4, (3, 3)), torch.ones(3, 3)
    known = torch.full((32, 36), 0.4)
    damaged = views.clone()
    damaged[0, 2], weights[0, 2] = math.nan, 0
    torch.testing.assert_close(
        extended_focus(damaged, known, weights), extended_focus(views, known, weights), atol=0, rtol=0
    )


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float16, torch.float32, torch.float64])
def test_types_and_batch_dimensions_follow_the_input(dtype):
    views = torch.rand(2, 1, 3, 3, 3, 20, 22)
    typed = views.to(dtype) if dtype.is_floating_point else (255 * views).round().to(dtype)
    sharp = extended_focus(typed, torch.zeros(2, 1, 20, 22))
    assert sharp.shape == (2, 1, 3, 20, 22)
    assert sharp.dtype == (dtype if dtype.is_floating_point else torch.float32)
    torch.testing.assert_close(sharp[1, 0].float(), extended_focus(views[1, 0], torch.zeros(20, 22)), atol=0.02, rtol=0)


@pytest.mark.parametrize(
    ("disparity", "message"), [(torch.zeros(3, 4), "disparity must be"), (torch.full((9, 9), math.nan), "finite")]
)
def test_maps_that_cannot_be_used_are_refused(disparity, message):
    with pytest.raises(InputError, match=message):
        extended_focus(torch.rand(3, 3, 1, 9, 9), disparity)
