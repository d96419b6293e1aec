"""What all refocusers share: what they take and refuse, which planes they make, and names that stay apart."""

import dataclasses
import functools

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lfref.errors import InputError
from lfref.lightfield import LightField
from lfref.refocus import apertures, batches
from lfref.refocus.fourier.disparity_layers import refocus_by_layers
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.slice import fourier_slice
from lfref.refocus.occlusion_aware import occlusion_aware
from lfref.refocus.separable_wiener import separable_wiener
from lfref.refocus.shift.shift_and_sum import shift_and_sum, shift_and_sum_through_cells
from lfref.refocuser.refocuser import (
    OperatorRefocuser,
    Refocuser,
    check_for_network,
    name_apart,
)
from lfref.simulator import sim30
from lfref.simulator.effects import optics
from lfref.simulator.effects.optics import Vignetting
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.simulate import simulate
from tests.refocus.conftest import shifted_views, texture

SLOPES = [-0.5, 0.0, 0.4]
EVERY = {
    "sum": shift_and_sum,
    "exact": exact_fourier,
    "cells": shift_and_sum_through_cells,
    "layers": refocus_by_layers,
    "aware": occlusion_aware,
    "separable": separable_wiener,
    "slice": fourier_slice,
}


def named(*names):
    made = [OperatorRefocuser(name, shift_and_sum) for name in names]
    name_apart(made)
    return [refocuser.name for refocuser in made]


@pytest.mark.parametrize("operator", [shift_and_sum, exact_fourier])
def test_a_light_field_and_its_views_give_the_operators_stack(operator):
    field, refocuser = LightField(torch.rand(3, 3, 1, 8, 9)), OperatorRefocuser("name", operator)
    expected = operator(field.views, SLOPES)
    assert torch.equal(refocuser(field, SLOPES), expected)
    assert torch.equal(refocuser(field.views, torch.tensor(SLOPES, dtype=torch.float64)), expected)
    assert torch.equal(refocuser(field.views[None], SLOPES), expected[None])


@pytest.mark.parametrize(
    ("views", "complaint"),
    [
        (
            np.zeros((3, 3, 1, 8, 8), np.float32),
            "LightField; got <class 'numpy.ndarray'>; torch.from_numpy",
        ),
        (torch.zeros(3, 3, 1, 8, 8, dtype=torch.int32), "uint8 or uint16; got torch.int32"),
        (torch.zeros(3, 3, 1, 8, 8, dtype=torch.bool), "uint8 or uint16; got torch.bool"),
        (torch.zeros(3, 3, 8, 8), r"must be \[..., V, U, C, H, W\]"),
    ],
)
def test_what_are_no_views_is_refused(views, complaint):
    with pytest.raises(InputError, match=complaint):
        OperatorRefocuser("name", shift_and_sum)(views, SLOPES)


@pytest.mark.parametrize("slopes", ["abc", ["a"], [[0.0], [1.0, 2.0]], [torch.nan]])
def test_what_are_no_slopes_is_refused(slopes):
    with pytest.raises(InputError, match="slopes must be"):
        OperatorRefocuser("name", shift_and_sum)(torch.rand(3, 3, 1, 8, 9), slopes)


def test_one_number_is_one_plane():
    views = torch.rand(3, 3, 1, 8, 9)
    assert torch.equal(OperatorRefocuser("name", shift_and_sum)(views, 0.4), shift_and_sum(views, [0.4]))


def test_who_makes_any_planes_must_be_told_which():
    with pytest.raises(InputError, match="name refocuses to any planes; got none; give slopes"):
        OperatorRefocuser("name", shift_and_sum)(torch.rand(3, 3, 1, 8, 8))


def test_names_that_occur_twice_get_a_number():
    assert named("a", "b", "a", "a") == ["a", "b", "a (2)", "a (3)"]


@given(names=st.lists(st.sampled_from(["a", "b", "a (2)"]), max_size=8))
def test_all_names_differ_and_begin_as_they_did(names):
    made = named(*names)
    assert len(set(made)) == len(names)
    assert all(new.startswith(old) for new, old in zip(made, names, strict=True))


CPU = torch.device("cpu")


def refocuser(**options):
    return OperatorRefocuser("shift_and_sum", functools.partial(shift_and_sum, **options))


def field(grid=(3, 5), size=(67, 21), seed=0, **more):
    return LightField(torch.rand(*grid, 3, *size, generator=torch.Generator().manual_seed(seed)), **more)


def test_views_go_to_the_device_of_the_method_and_the_stack_back():
    class Elsewhere(Refocuser):
        name, device = "elsewhere", torch.device("meta")

        def stack(self, views, weight, slopes, positions=None):
            assert views.device == self.device
            return torch.ones(len(slopes), *views.shape[-3:])  # "meta" holds no values to move back

    for light in (torch.rand(3, 3, 1, 12, 13), LightField(torch.rand(3, 3, 1, 12, 13))):
        assert Elsewhere()(light, [0.0, 1.0]).shape == (2, 1, 12, 13)


@pytest.mark.parametrize("ratio", [0.999, 1.001])
def test_one_sample_that_drowns_all_others_is_refused_and_named(ratio):
    views = torch.ones(3, 3, 3, 8, 8)
    views[2, 1, 0, 5, 7] = 1e6 * ratio
    if ratio < 1:
        check_for_network("net", views, None, views.device)
    else:
        with pytest.raises(InputError, match=r"\(2, 1, 0, 5, 7\)"):
            check_for_network("net", views, None, views.device)


def test_lights_on_black_are_no_such_sample():
    views = torch.zeros(3, 3, 3, 32, 32)
    views[:, :, :, 5, 7] = 1e9
    check_for_network("net", views, None, views.device)


FOCI = torch.tensor([-1.5, 0.0, 0.4], dtype=torch.float64)


def weighted_field(weight=None, *, grid=(3, 3), size=(14, 15)):
    return LightField(torch.rand(*grid, 3, *size, dtype=torch.float64), weight=weight)


def test_without_weight_the_operator_alone_is_used():
    plain = weighted_field()
    assert torch.equal(OperatorRefocuser("name", shift_and_sum)(plain, FOCI), shift_and_sum(plain.views, FOCI))


FILLED = functools.partial(shift_and_sum, fill=1.0)


@pytest.mark.parametrize(
    "operator", [shift_and_sum, exact_fourier, functools.partial(shift_and_sum, border="zero"), FILLED]
)
@pytest.mark.parametrize("level", [1.0, 0.3])
def test_a_weight_that_is_the_same_everywhere_changes_only_what_the_border_leaves_out(operator, level):
    plain = weighted_field()
    level_field = LightField(plain.views, weight=torch.full((3, 3, 1, 14, 15), level, dtype=torch.float64))
    stack, expected = OperatorRefocuser("name", operator)(level_field, FOCI), operator(plain.views, FOCI)
    inner = (..., slice(2, -2), slice(2, -2))
    torch.testing.assert_close(stack[inner], expected[inner], atol=1e-12, rtol=0)


@pytest.mark.parametrize("border", ["renormalize", "edge", "wrap"])
def test_whole_shifts_give_the_weighted_mean_of_what_is_read(border):
    weight = torch.rand(3, 3, 1, 14, 15, dtype=torch.float64) + 0.01
    sampled = weighted_field(weight)
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
    first = weighted_field(weight)
    second = LightField(torch.where(weight > 0, first.views, 7.0), weight=weight)
    operator = shift_and_sum
    torch.testing.assert_close(
        OperatorRefocuser("name", operator)(first, FOCI), OperatorRefocuser("name", operator)(second, FOCI)
    )


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("wild", [torch.nan, torch.inf])
def test_samples_that_weigh_nothing_may_be_anything(name, wild):
    weight = torch.ones(5, 5, 1, 40, 44)
    weight[1, 2, 0, 10:14, 20:23] = 0
    views = torch.where(weight > 0, torch.rand(5, 5, 3, 40, 44), 0)
    refocuser = OperatorRefocuser(name, EVERY[name])
    expected = refocuser(LightField(views, weight=weight), [0.3])
    assert torch.equal(refocuser(LightField(views.masked_fill(weight == 0, wild), weight=weight), [0.3]), expected)


@pytest.mark.parametrize("border", ["renormalize", "edge", "wrap"])
def test_through_cells_samples_count_by_their_blurred_weight(border):
    weight = torch.rand(3, 3, 1, 14, 15, dtype=torch.float64) + 0.01
    level = LightField(torch.full((3, 3, 3, 14, 15), 0.6, dtype=torch.float64), weight=weight)
    operator = functools.partial(FILLED, border=border)
    stack = OperatorRefocuser("name", operator)(level, FOCI)
    torch.testing.assert_close(stack, torch.full_like(stack, 0.6), atol=1e-12, rtol=0)


def test_a_pixel_without_any_trusted_sample_is_black():
    weight = torch.ones(3, 3, 1, 14, 15, dtype=torch.float64)
    weight[..., 4:11, 4:11] = 0
    stack = OperatorRefocuser("name", shift_and_sum)(weighted_field(weight), torch.tensor([0.0, 1.0]))
    assert not stack[0, :, 4:11, 4:11].any()
    assert not stack[1, :, 5:10, 5:10].any()
    assert bool((stack[1, :, 4, 4:11] > 0).all())


def test_gradients_are_finite_where_nothing_is_trusted():
    weight = torch.zeros(3, 3, 1, 14, 15, dtype=torch.float64)
    weight[..., :7] = 1
    views = torch.rand(3, 3, 1, 14, 15, dtype=torch.float64, requires_grad=True)
    OperatorRefocuser("name", shift_and_sum)(LightField(views, weight=weight), FOCI).square().sum().backward()
    assert bool(views.grad.isfinite().all())
    assert bool((views.grad[..., 8:] == 0).all())


def test_the_type_follows_the_views():
    sampled = LightField(torch.rand(3, 3, 1, 14, 15), weight=torch.ones(3, 3, 1, 14, 15, dtype=torch.float64))
    assert OperatorRefocuser("name", shift_and_sum)(sampled, FOCI).dtype == torch.float32


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16])
def test_whole_numbers_are_scaled(dtype):
    full = 255 if dtype == torch.uint8 else 65535
    views = torch.randint(full + 1, (3, 3, 3, 14, 15)).to(dtype)
    stack = OperatorRefocuser("name", shift_and_sum)(views, FOCI)
    torch.testing.assert_close(stack, shift_and_sum(views.float() / full, FOCI))


def test_an_aperture_weighs_the_views_of_any_grid():
    refocuser = OperatorRefocuser("name", shift_and_sum, functools.partial(apertures.disc, diameter=2))
    for grid in ((3, 3), (4, 5)):
        views = torch.rand(2, *grid, 3, 14, 15)
        expected = shift_and_sum(views, FOCI, weights=apertures.disc(grid, 2))
        assert torch.equal(refocuser(views, FOCI), expected)


def test_an_operator_without_weights_works_at_full_aperture_only():
    def mean(views, slopes):
        return views.mean((-5, -4)).unsqueeze(-4).expand(*views.shape[:-5], len(slopes), *views.shape[-3:])

    views = torch.rand(3, 3, 1, 6, 7)
    assert OperatorRefocuser("mean", mean, apertures.full)(views, FOCI).shape == (len(FOCI), 1, 6, 7)
    with pytest.raises(InputError, match="mean must have a parameter weights"):
        OperatorRefocuser("mean", mean, apertures.disc)


def test_another_aperture_makes_another_refocuser_unless_it_has_one_of_its_own():
    light, plain = weighted_field(), OperatorRefocuser("name", exact_fourier)
    round_one = plain.through(apertures.disc)
    weights = apertures.disc((3, 3))
    assert torch.equal(round_one(light, FOCI), exact_fourier(light.views, FOCI, weights=weights))
    assert round_one.name == "name"
    assert plain.aperture is None
    assert plain.through(None) is plain
    assert round_one.through(apertures.full) is round_one


@pytest.mark.parametrize(
    ("options", "width"),
    [({}, 0.0), ({"fill": 1.0}, 1.5), ({"fill": 2.0, "disparity": 0.5}, 4.0), ({"disparity": 0.5}, 0.0)],
)
def test_the_widest_cell_is_that_of_the_plane_farthest_from_the_disparity(options, width):
    assert OperatorRefocuser("name", functools.partial(shift_and_sum, **options)).cell_width(FOCI) == width


def test_cells_before_a_map_are_as_wide_as_at_its_farthest_disparity():
    behind = functools.partial(shift_and_sum, fill=1.0, disparity=torch.tensor([[0.0, 1.0], [0.5, -0.2]]))
    assert OperatorRefocuser("name", behind).cell_width(FOCI) == 2.5


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
    border = 8
    difference = stack - refocuser(whole, [-1.2, 0.5])
    assert float(difference[1, :, border:-border, border:-border].abs().max()) < 0.05


@pytest.mark.parametrize("name", ["sum", "exact", "cells", "slice"])
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


@pytest.mark.parametrize("name", ["separable", "aware"])
def test_views_of_some_weight_are_read_as_they_are_by_methods_of_symmetric_weights(name):
    views, weights = torch.rand(5, 5, 3, 40, 44), torch.ones(5, 5)
    weights[0, 1] = 0.5
    sampled = LightField(views, weight=weights[:, :, None, None, None].expand(5, 5, 1, 40, 44))
    assert torch.equal(OperatorRefocuser(name, EVERY[name])(sampled, [0.4]), EVERY[name](views, [0.4]))
    refocuser = OperatorRefocuser(name, EVERY[name], apertures.disc)
    expected = EVERY[name](views, [0.4], weights=apertures.disc((5, 5)))
    assert torch.equal(refocuser(sampled, [0.4]), expected)


@pytest.mark.parametrize("name", ["cells", "layers", "aware"])
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
    gain = optics.falloff(made.views, 0.6) * optics.clipped_pupil(made.views, 0.5)
    weight = torch.where(gain > 0.05, gain, 0.0)
    mended = LightField(torch.where(weight > 0, made.views / gain.clamp(min=0.05), 0.0), weight=weight)
    stack = OperatorRefocuser(name, EVERY[name])(mended, made.slopes)
    error = (stack - made.truth)[..., 24:-24, 24:-24].square().mean((1, 2, 3))
    assert float(-10 * error.log10().mean()) > psnr


@pytest.mark.parametrize("name", ["sum", "exact", "cells"])
@pytest.mark.parametrize("with_weight", [False, True])
def test_positions_of_cameras_are_handed_on(name, with_weight):
    views, stand = torch.rand(3, 3, 3, 14, 15), batches.even((3, 3)) * 1.2 + 0.1
    weight = torch.ones(3, 3, 1, 14, 15)
    weight[0, 1] = 0
    uneven = LightField(views, weight=weight if with_weight else None, positions=stand)
    expected = EVERY[name](views, FOCI, positions=stand, weights=weight[..., 0, 0, 0] if with_weight else None)
    assert torch.equal(OperatorRefocuser(name, EVERY[name])(uneven, FOCI), expected)


def test_weighted_samples_of_cameras_anywhere_are_their_weighted_mean():
    stand, weight = batches.even((3, 3)) * 1.2, torch.rand(3, 3, 1, 14, 15, dtype=torch.float64) + 0.1
    light = dataclasses.replace(weighted_field(weight), positions=stand)
    share, total = (shift_and_sum(each, FOCI, positions=stand) for each in (weight, light.views * weight))
    stack = OperatorRefocuser("sum", shift_and_sum)(light, FOCI)
    torch.testing.assert_close(stack, total / share, atol=1e-12, rtol=0)


@pytest.mark.parametrize("name", ["layers", "aware", "slice"])
def test_methods_of_even_grids_name_others_for_cameras_elsewhere(name):
    uneven = LightField(torch.rand(3, 3, 3, 14, 15), positions=batches.even((3, 3)) * 1.2)
    with pytest.raises(InputError, match=f"{name} needs cameras on an even grid; .* take method=shift_and_sum"):
        OperatorRefocuser(name, EVERY[name])(uneven, FOCI)


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


@pytest.mark.parametrize("name", ["cells", "layers", "aware"])
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


@pytest.mark.parametrize(
    ("output", "got"), [(None, "NoneType"), (np.zeros(3), "ndarray"), (torch.zeros(4, 4), r"shape \[4, 4\]")]
)
def test_an_operator_that_returns_no_stack_is_named(output, got):
    def operator(views, slopes, weights=None):
        return output

    refocuser = OperatorRefocuser("mine", operator)
    for light in (torch.rand(3, 3, 3, 8, 9), LightField(torch.rand(3, 3, 3, 8, 9))):
        with pytest.raises(InputError, match=rf"mine must return a stack \[\.\.\., N, C, H, W\]; got {got}"):
            refocuser(light, [0.5])


def test_slopes_may_be_an_array_in_reverse():
    views = torch.rand(3, 3, 1, 8, 9)
    stack = shift_and_sum(views, np.array([0.5, 0.0])[::-1])
    assert torch.equal(stack, shift_and_sum(views, [0.0, 0.5]))
