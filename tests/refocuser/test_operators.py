"""Samples count by their weight: the weighted mean over the views, sample by sample."""

import dataclasses
import functools

import pytest
import torch

from lfref.errors import InputError
from lfref.lightfield import LightField
from lfref.refocus import apertures, lines
from lfref.refocus.fourier.disparity_layers import refocus_by_layers
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.slice import fourier_slice
from lfref.refocus.fourier.super_resolution import super_resolve
from lfref.refocus.occlusion_aware import occlusion_aware
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.through_cells import shift_and_sum_through_cells
from lfref.refocuser import operators
from lfref.refocuser.operators import OperatorRefocuser
from lfref.simulator import sim30
from lfref.simulator.effects import vignetting
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.effects.vignetting import Vignetting
from lfref.simulator.simulate import simulate
from tests.refocus.conftest import shifted_views, texture

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


def test_an_operator_without_weights_works_at_full_aperture_only():
    def mean(views, slopes):
        return views.mean((-5, -4)).unsqueeze(-4).expand(*views.shape[:-5], len(slopes), *views.shape[-3:])

    views = torch.rand(3, 3, 1, 6, 7)
    assert OperatorRefocuser("mean", mean, apertures.full)(views, SLOPES).shape == (len(SLOPES), 1, 6, 7)
    with pytest.raises(InputError, match="mean must have a parameter weights"):
        OperatorRefocuser("mean", mean, apertures.disc)


def test_another_aperture_makes_another_refocuser_unless_it_has_one_of_its_own():
    light, plain = field(), OperatorRefocuser("name", exact_fourier)
    round_one = plain.through(apertures.disc)
    weights = apertures.disc((3, 3))
    assert torch.equal(round_one(light, SLOPES), exact_fourier(light.views, SLOPES, weights=weights))
    assert round_one.name == "name"
    assert plain.aperture is None
    assert plain.through(None) is plain
    assert round_one.through(apertures.full) is round_one


@pytest.mark.parametrize(
    ("options", "width"),
    [({}, 0.0), ({"fill": 1.0}, 1.5), ({"fill": 2.0, "disparity": 0.5}, 4.0), ({"disparity": 0.5}, 0.0)],
)
def test_the_widest_cell_is_that_of_the_plane_farthest_from_the_disparity(options, width):
    assert OperatorRefocuser("name", functools.partial(shift_and_sum, **options)).cell_width(SLOPES) == width


def test_cells_before_a_map_are_as_wide_as_at_its_farthest_disparity():
    behind = functools.partial(shift_and_sum, fill=1.0, disparity=torch.tensor([[0.0, 1.0], [0.5, -0.2]]))
    assert OperatorRefocuser("name", behind).cell_width(SLOPES) == 2.5


EVERY = {
    "sum": shift_and_sum,
    "exact": exact_fourier,
    "cells": shift_and_sum_through_cells,
    "layers": refocus_by_layers,
    "aware": occlusion_aware,
    "finer": super_resolve,
    "slice": fourier_slice,
}


def with_holes(holes, grid=(5, 5), size=(40, 44)):
    """A field of a plane at disparity .5, without some of its views, and with rubbish in their place."""
    weight = torch.ones(*grid, 1, *size, dtype=torch.float64)
    for hole in holes:
        weight[hole] = 0
    whole = shifted_views(texture(3, *size), 0.5, grid)
    black, wild = torch.where(weight > 0, whole, 0.0), torch.where(weight > 0, whole, 7.0)
    return LightField(whole), LightField(black, weight=weight), LightField(wild, weight=weight)


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("holes", [[(0, 3)], [(2, 2)], [(0, 0), (0, 4), (4, 0), (4, 4)]])
def test_what_a_missing_view_holds_is_never_seen(name, holes):
    whole, black, wild = with_holes(holes)
    refocuser = OperatorRefocuser(name, EVERY[name])
    stack = refocuser(black, [-1.2, 0.5])
    torch.testing.assert_close(refocuser(wild, [-1.2, 0.5]), stack, atol=1e-9, rtol=0)
    border = 16 if name == "finer" else 8
    difference = stack - refocuser(whole, [-1.2, 0.5])
    assert float(difference[1, :, border:-border, border:-border].abs().max()) < 0.05


@pytest.mark.parametrize("name", ["sum", "exact", "cells", "finer", "slice"])
def test_weights_of_whole_views_are_an_aperture(name):
    views, weights = torch.rand(5, 4, 3, 20, 24), torch.rand(5, 4)
    weights[1, 2] = 0
    sampled = LightField(views, weight=weights[:, :, None, None, None].expand(5, 4, 1, 20, 24))
    expected = EVERY[name](views, [0.3], weights=weights)
    assert torch.equal(OperatorRefocuser(name, EVERY[name])(sampled, [0.3]), expected)
    disc = apertures.disc((5, 4))
    through = OperatorRefocuser(name, EVERY[name], apertures.disc)(sampled, [0.3])
    assert torch.equal(through, EVERY[name](views, [0.3], weights=weights * disc))


@pytest.mark.parametrize("name", EVERY)
def test_views_that_all_weigh_the_same_are_as_if_they_had_no_weights(name):
    views = torch.rand(5, 4, 3, 20, 24)
    sampled = LightField(views, weight=torch.full((5, 4, 1, 20, 24), 0.4))
    assert torch.equal(OperatorRefocuser(name, EVERY[name])(sampled, [0.3]), EVERY[name](views, [0.3]))


@pytest.mark.parametrize("name", ["cells", "layers", "aware", "finer"])
def test_methods_that_look_take_samples_of_some_weight_as_they_are(name):
    views, weight = torch.rand(5, 5, 3, 40, 44), 0.3 + 0.7 * torch.rand(5, 5, 1, 40, 44)
    stack = OperatorRefocuser(name, EVERY[name])(LightField(views, weight=weight), [0.4])
    assert torch.equal(stack, EVERY[name](views, [0.4]))


def test_no_view_of_any_weight_is_black():
    black = LightField(torch.rand(3, 3, 3, 20, 24), weight=torch.zeros(3, 3, 1, 20, 24))
    for name in ("sum", "cells"):
        assert not OperatorRefocuser(name, EVERY[name])(black, [0.4]).any()


# Weighted sums of vignetted views are no photograph through the whole aperture: 46 and 47 dB.
@pytest.mark.parametrize(("name", "psnr"), [("cells", 50.0), ("aware", 52.0)])
def test_vignetted_views_over_their_gain_are_near_the_truth(name, psnr):
    scene = dataclasses.replace(sim30.SCENES["vignetting"], sensor=Sensor(vignetting=Vignetting(0.6, 0.5)))
    made = simulate(scene, slopes=[-1.5, -0.3, 0.4])
    gain = vignetting.falloff(made.views, 0.6) * vignetting.clipped_pupil(made.views, 0.5)
    weight = torch.where(gain > 0.05, gain, 0.0)
    mended = LightField(torch.where(weight > 0, made.views / gain.clamp(min=0.05), 0.0), weight=weight)
    stack = OperatorRefocuser(name, EVERY[name])(mended, made.slopes)
    error = (stack - made.truth)[..., 24:-24, 24:-24].square().mean((1, 2, 3))
    assert float(-10 * error.log10().mean()) > psnr


@pytest.mark.parametrize("name", ["sum", "exact", "cells"])
@pytest.mark.parametrize("with_weight", [False, True])
def test_positions_of_cameras_are_handed_on(name, with_weight):
    views, stand = torch.rand(3, 3, 3, 14, 15), lines.even((3, 3)) * 1.2 + 0.1
    weight = torch.ones(3, 3, 1, 14, 15)
    weight[0, 1] = 0
    uneven = LightField(views, weight=weight if with_weight else None, positions=stand)
    expected = EVERY[name](views, SLOPES, positions=stand, weights=weight[..., 0, 0, 0] if with_weight else None)
    assert torch.equal(OperatorRefocuser(name, EVERY[name])(uneven, SLOPES), expected)


def test_weighted_samples_of_cameras_anywhere_are_their_weighted_mean():
    stand, weight = lines.even((3, 3)) * 1.2, torch.rand(3, 3, 1, 14, 15, dtype=torch.float64) + 0.1
    light = dataclasses.replace(field(weight), positions=stand)
    share, total = (shift_and_sum(each, SLOPES, positions=stand) for each in (weight, light.views * weight))
    stack = OperatorRefocuser("sum", shift_and_sum)(light, SLOPES)
    torch.testing.assert_close(stack, total / share, atol=1e-12, rtol=0)


@pytest.mark.parametrize("name", ["layers", "aware", "finer", "slice"])
def test_methods_of_even_grids_name_others_for_cameras_elsewhere(name):
    uneven = LightField(torch.rand(3, 3, 3, 14, 15), positions=lines.even((3, 3)) * 1.2)
    with pytest.raises(InputError, match=f"{name} needs cameras on an even grid; .* take method=shift_and_sum"):
        OperatorRefocuser(name, EVERY[name])(uneven, SLOPES)


CUBIC = functools.partial(shift_and_sum, interpolation="cubic")
EXACT = functools.partial(shift_and_sum, interpolation="exact")
ROUNDED = {**EVERY, "cubic": CUBIC, "exact sum": EXACT}


def with_black_corners(views, dark=0.0):
    """A field whose samples beyond a slanted line count for nothing, as in the corners of a lens."""
    height, width = views.shape[-2:]
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    is_seen = (y + 2 * x > 24)[None].expand(*views.shape[:2], 1, height, width)
    return LightField(torch.where(is_seen, views, dark), weight=is_seen.to(views))


@pytest.mark.parametrize("name", ROUNDED)
@pytest.mark.parametrize("slope", [-1.3, 0.03, 0.45])
def test_at_black_corners_pictures_stay_within_what_the_views_show(name, slope):
    noisy = 0.5 + 0.02 * torch.rand(5, 5, 1, 44, 48, dtype=torch.float64)
    stack = OperatorRefocuser(name, ROUNDED[name])(with_black_corners(noisy), [slope])
    # Weights below 0, and rings of the exact ones, go a little beyond the samples, but never to light and dark dots.
    is_within = (stack - 0.51).abs() < 0.06
    assert bool((is_within | (stack == 0)).all())
    assert bool((stack[..., -20:, -36:] > 0).all())
    assert float((stack == 0).double().mean()) < 0.1


@pytest.mark.parametrize("name", ["cells", "layers", "aware", "finer"])
def test_blurs_mix_in_nothing_from_black_corners(name):
    level = torch.full((5, 5, 3, 44, 48), 0.4, dtype=torch.float64)
    stack = OperatorRefocuser(name, EVERY[name])(with_black_corners(level), [-3.0, 0.1])
    torch.testing.assert_close(stack, torch.where(stack == 0, stack, 0.4), atol=1e-6, rtol=0)


def test_a_trace_of_weight_that_interpolation_leaves_shows_nothing():
    light = with_black_corners(torch.rand(5, 5, 3, 44, 48, dtype=torch.float64))
    leaky = dataclasses.replace(light, weight=light.weight.clamp(min=1e-6))
    for name in ("cells", "cubic"):
        refocuser = OperatorRefocuser(name, ROUNDED[name])
        torch.testing.assert_close(refocuser(leaky, [0.03]), refocuser(light, [0.03]), atol=1e-4, rtol=0)


def test_pictures_sharp_everywhere_are_black_only_in_black_corners():
    light = with_black_corners(torch.rand(5, 5, 3, 44, 48, dtype=torch.float64))
    picture = OperatorRefocuser("focus", operators.focus)(light, [-1.0, 0.0, 1.0])
    assert picture.shape == (1, 3, 44, 48)
    assert not picture[..., :4, :4].any()
    assert bool((picture[..., 20:, 20:] > 0).all())
