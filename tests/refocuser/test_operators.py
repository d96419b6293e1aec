"""Samples count by their weight: the weighted mean over the views, sample by sample."""

import functools

import pytest
import torch

from lfref.lightfield import LightField
from lfref.refocus import apertures
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser import operators
from lfref.refocuser.operators import OperatorRefocuser

SLOPES = torch.tensor([-1.5, 0.0, 0.4], dtype=torch.float64)


def field(weight=None, *, grid=(3, 3), size=(14, 15)):
    return LightField(torch.rand(*grid, 3, *size, dtype=torch.float64), weight=weight)


def test_without_weight_the_operator_alone_is_used():
    plain = field()
    assert torch.equal(OperatorRefocuser("name", shift_and_sum)(plain, SLOPES), shift_and_sum(plain.views, SLOPES))


FILLED = functools.partial(shift_and_sum, fill=1.0)


@pytest.mark.parametrize(
    "operator", [shift_and_sum, exact_fourier, functools.partial(shift_and_sum, border="zero"), FILLED]
)
@pytest.mark.parametrize("level", [1.0, 0.3])
def test_a_weight_that_is_the_same_everywhere_changes_only_what_the_border_leaves_out(operator, level):
    plain = field()
    level_field = LightField(plain.views, weight=torch.full((3, 3, 1, 14, 15), level, dtype=torch.float64))
    stack, expected = OperatorRefocuser("name", operator)(level_field, SLOPES), operator(plain.views, SLOPES)
    inner = (..., slice(2, -2), slice(2, -2))
    torch.testing.assert_close(stack[inner], expected[inner], atol=1e-12, rtol=0)


@pytest.mark.parametrize("border", ["renormalize", "edge", "wrap"])
def test_whole_shifts_give_the_weighted_mean_of_what_is_read(border):
    weight = torch.rand(3, 3, 1, 14, 15, dtype=torch.float64) + 0.01
    sampled = field(weight)
    stack = OperatorRefocuser("name", functools.partial(shift_and_sum, border=border))(sampled, torch.tensor([1.0]))
    for y, x in [(5, 5), (7, 3), (12, 13), (6, 9)]:
        total, weights = torch.zeros(3, dtype=torch.float64), 0.0
        for v in range(3):
            for u in range(3):
                row, column = y + v - 1, x + u - 1
                total += weight[v, u, 0, row, column] * sampled.views[v, u, :, row, column]
                weights += weight[v, u, 0, row, column]
        torch.testing.assert_close(stack[0, :, y, x], total / weights, atol=1e-12, rtol=0)


def test_the_colour_of_samples_that_weigh_nothing_does_not_matter():
    weight = (torch.rand(3, 3, 1, 14, 15) > 0.4).double()
    first = field(weight)
    second = LightField(torch.where(weight > 0, first.views, 7.0), weight=weight)
    operator = shift_and_sum
    torch.testing.assert_close(
        OperatorRefocuser("name", operator)(first, SLOPES), OperatorRefocuser("name", operator)(second, SLOPES)
    )


@pytest.mark.parametrize("border", ["renormalize", "edge", "wrap"])
def test_through_cells_samples_count_by_their_blurred_weight(border):
    weight = torch.rand(3, 3, 1, 14, 15, dtype=torch.float64) + 0.01
    level = LightField(torch.full((3, 3, 3, 14, 15), 0.6, dtype=torch.float64), weight=weight)
    operator = functools.partial(FILLED, border=border)
    stack = OperatorRefocuser("name", operator)(level, SLOPES)
    torch.testing.assert_close(stack, torch.full_like(stack, 0.6), atol=1e-12, rtol=0)


def test_a_pixel_without_any_trusted_sample_is_black():
    weight = torch.ones(3, 3, 1, 14, 15, dtype=torch.float64)
    weight[..., 4:11, 4:11] = 0
    stack = OperatorRefocuser("name", shift_and_sum)(field(weight), torch.tensor([0.0, 1.0]))
    assert not stack[0, :, 4:11, 4:11].any()
    assert not stack[1, :, 5:10, 5:10].any()
    assert bool((stack[1, :, 4, 4:11] > 0).all())


def test_gradients_are_finite_where_nothing_is_trusted():
    weight = torch.zeros(3, 3, 1, 14, 15, dtype=torch.float64)
    weight[..., :7] = 1
    views = torch.rand(3, 3, 1, 14, 15, dtype=torch.float64, requires_grad=True)
    OperatorRefocuser("name", shift_and_sum)(LightField(views, weight=weight), SLOPES).square().sum().backward()
    assert bool(views.grad.isfinite().all())
    assert bool((views.grad[..., 8:] == 0).all())


def test_the_type_follows_the_views():
    sampled = LightField(torch.rand(3, 3, 1, 14, 15), weight=torch.ones(3, 3, 1, 14, 15, dtype=torch.float64))
    assert OperatorRefocuser("name", shift_and_sum)(sampled, SLOPES).dtype == torch.float32


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16])
def test_whole_numbers_are_scaled(dtype):
    full = 255 if dtype == torch.uint8 else 65535
    views = torch.randint(full + 1, (3, 3, 3, 14, 15)).to(dtype)
    stack = OperatorRefocuser("name", shift_and_sum)(views, SLOPES)
    torch.testing.assert_close(stack, shift_and_sum(views.float() / full, SLOPES))


def test_an_aperture_weighs_the_views_of_any_grid():
    refocuser = OperatorRefocuser("name", shift_and_sum, functools.partial(apertures.disc, diameter=2))
    for grid in ((3, 3), (4, 5)):
        views = torch.rand(2, *grid, 3, 14, 15)
        expected = shift_and_sum(views, SLOPES, weights=apertures.disc(grid, 2))
        assert torch.equal(refocuser(views, SLOPES), expected)


def test_even_stack_fills_the_span_of_the_slopes():
    views = torch.rand(2, 3, 3, 1, 12, 13, dtype=torch.float64)
    stack, slopes = operators.even_stack(views, torch.tensor([0.6, -1.0, 0.0])), [-1.0, -0.2, 0.6]
    torch.testing.assert_close(stack, exact_fourier(views, slopes), atol=1e-6, rtol=0)


def test_coplanar_homographies_are_shift_and_sum():
    views = torch.rand(3, 4, 2, 12, 13, dtype=torch.float64)
    stack = operators.coplanar_homography(views, SLOPES)
    torch.testing.assert_close(stack, shift_and_sum(views, SLOPES), atol=1e-12, rtol=0)


def test_focus_takes_every_pixel_from_one_of_the_planes():
    views = torch.rand(2, 3, 3, 1, 12, 13)
    picture, stack = operators.focus(views, SLOPES), shift_and_sum(views, SLOPES)
    assert picture.shape == (2, 1, 1, 12, 13)
    assert bool((picture == stack).any(dim=1).all())


def test_another_aperture_makes_another_refocuser_unless_it_has_one_of_its_own():
    light, plain = field(), OperatorRefocuser("name", exact_fourier)
    round_one = plain.through(apertures.disc)
    weights = apertures.disc((3, 3))
    assert torch.equal(round_one(light, SLOPES), exact_fourier(light.views, SLOPES, weights=weights))
    assert round_one.name == "name"
    assert plain.aperture is None
    assert plain.through(None) is plain
    assert round_one.through(apertures.full) is round_one
