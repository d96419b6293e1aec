"""All-in-focus: known disparities come back, the picture is that of the sharp planes, flat areas claim nothing."""

import functools

import pytest
import torch

from lfref.errors import InputError
from lfref.functional import neighbours
from lfref.functional.psnr import psnr
from lfref.refocus.focus.all_in_focus import all_in_focus, extended_focus, index_to_slope
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate
from tests.refocus.conftest import layered_views, shifted_views, texture

SLOPES = torch.linspace(-1, 1, 9, dtype=torch.float64)
STEP = 0.25


@pytest.mark.parametrize(("near", "far"), [(0.5, -0.5), (0.87, -0.31)])
def test_two_layers_come_back_within_half_a_step(near, far):
    views, distance = layered_views(near, far)
    slopes = index_to_slope(all_in_focus(exact_fourier(views, SLOPES)).index, SLOPES)
    assert (slopes - near).abs()[distance < 12].max() < STEP / 2
    inner = torch.zeros_like(distance, dtype=torch.bool)
    inner[4:-4, 4:-4] = True
    assert (slopes - far).abs()[inner & (distance > 28)].max() < STEP / 2


def test_the_index_of_a_gaussian_peak_is_its_centre():
    height = torch.exp(-(torch.arange(7, dtype=torch.float64) - 3.3).square() / 8)
    stack = height[:, None, None, None] * torch.rand(1, 32, 33, dtype=torch.float64) * 10
    torch.testing.assert_close(
        all_in_focus(stack).index, torch.full((32, 33), 3.3, dtype=torch.float64), atol=1e-4, rtol=0
    )


def test_confidence_is_the_lead_over_planes_that_are_not_neighbours():
    detail = torch.rand(3, 30, 30, dtype=torch.float64)
    heights = torch.tensor([0.5, 0.2, 0.9, 1.0, 0.8], dtype=torch.float64)
    confidence = all_in_focus(detail * heights[:, None, None, None]).confidence
    # Sharpness goes with the square; the floor of 8-bit rounding hardly counts beside such detail.
    torch.testing.assert_close(confidence, torch.full_like(confidence, 1 - 0.5**2), atol=1e-3, rtol=0)


def test_gradients_are_right():
    stack = torch.rand(4, 2, 6, 7, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: tuple(all_in_focus(x)), stack)


@pytest.mark.parametrize("detail", [0.0, 1e-6, 1.0])
def test_gradients_are_finite_on_flat_and_on_equal_planes(detail):
    stack = (0.5 + detail * torch.rand(1, 3, 12, 12)).repeat(5, 1, 1, 1).requires_grad_()
    found = all_in_focus(stack)
    (found.image.sum() + found.index.sum() + found.confidence.sum()).backward()
    assert bool(stack.grad.isfinite().all())


@pytest.mark.parametrize(
    "change", [{"stack": torch.rand(3, 8, 8)}, {"stack": torch.ones(2, 3, 8, 8, dtype=torch.uint8)}, {"radius": -1.0}]
)
def test_bad_arguments_are_refused(change):
    with pytest.raises(InputError):
        all_in_focus(**({"stack": torch.rand(2, 3, 8, 8)} | change))


@pytest.mark.parametrize("slopes", [[-1.0, 0.0, 2.0], [2.0, 0.0, -1.0]])
def test_slopes_are_linear_between_planes(slopes):
    index = torch.tensor([[0.0, 0.5, 1.0], [1.25, 2.0, 2.5]], dtype=torch.float64)
    between = [[slopes[0], sum(slopes[:2]) / 2, slopes[1]], [0.75 * slopes[1] + 0.25 * slopes[2], slopes[2], slopes[2]]]
    torch.testing.assert_close(index_to_slope(index, slopes), torch.tensor(between, dtype=torch.float64))


@pytest.mark.parametrize(
    ("operator", "scene"),
    [(exact_fourier, "floor"), (functools.partial(shift_and_sum, interpolation="cubic"), "dome")],
)
def test_borders_show_no_bands_of_planes_that_are_out_of_focus(operator, scene):
    made = simulate(sim30.SCENES[scene], outputs=("views", "disparity"))
    slopes = torch.linspace(float(made.disparity.min()) - 0.1, float(made.disparity.max()) + 0.1, 16)
    found = index_to_slope(all_in_focus(operator(made.views, slopes)).index, slopes)
    is_right = (found - made.disparity).abs() < 0.15
    is_right[6:-6, 6:-6] = True
    assert float((~is_right).sum()) < 0.01 * (is_right.numel() - is_right[6:-6, 6:-6].numel())


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
