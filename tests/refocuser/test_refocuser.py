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
from lfref.refocus.blockwise_wiener import blockwise_wiener
from lfref.refocus.fourier.disparity_layers import refocus_by_layers
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.slice import fourier_slice
from lfref.refocus.separable_wiener import separable_wiener
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.shift_and_sum_antialiased import shift_and_sum_antialiased
from lfref.refocuser.refocuser import (
    OperatorRefocuser,
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
    "cells": shift_and_sum_antialiased,
    "layers": refocus_by_layers,
    "aware": blockwise_wiener,
    "separable": separable_wiener,
    "slice": fourier_slice,
}


@pytest.mark.parametrize("operator", [shift_and_sum, exact_fourier])
def test_a_light_field_and_its_views_give_the_operators_stack(operator):
    field, refocuser = LightField(torch.rand(3, 3, 1, 8, 9)), OperatorRefocuser("name", operator)
    expected = operator(field.views, SLOPES)
    assert torch.equal(refocuser(field, SLOPES), expected)
    assert torch.equal(refocuser(field.views, torch.tensor(SLOPES, dtype=torch.float64)), expected)
    assert torch.equal(refocuser(field.views[None], SLOPES), expected[None])


@pytest.mark.parametrize(
    ("views", "slopes"),
    [
        (np.zeros((3, 3, 1, 8, 8), np.float32), SLOPES),
        (torch.zeros(3, 3, 1, 8, 8, dtype=torch.int32), SLOPES),
        (torch.zeros(3, 3, 8, 8), SLOPES),
        (torch.rand(3, 3, 1, 8, 9), "abc"),
        (torch.rand(3, 3, 1, 8, 9), [[0.0], [1.0, 2.0]]),
        (torch.rand(3, 3, 1, 8, 9), None),
    ],
)
def test_what_are_no_views_or_no_slopes_is_refused(views, slopes):
    with pytest.raises(InputError):
        OperatorRefocuser("name", shift_and_sum)(views, slopes)


@given(names=st.lists(st.sampled_from(["a", "b", "a (2)"]), max_size=8))
def test_all_names_differ_and_begin_as_they_did(names):
    refocusers = [OperatorRefocuser(name, shift_and_sum) for name in names]
    name_apart(refocusers)
    made = [refocuser.name for refocuser in refocusers]
    assert len(set(made)) == len(names)
    assert all(new.startswith(old) for new, old in zip(made, names, strict=True))


FOCI = torch.tensor([-1.5, 0.0, 0.4], dtype=torch.float64)


def weighted_field(weight=None, *, grid=(3, 3), size=(14, 15)):
    return LightField(torch.rand(*grid, 3, *size, dtype=torch.float64), weight=weight)


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


@pytest.mark.parametrize("name", EVERY)
def test_samples_that_weigh_nothing_may_be_anything(name):
    weight = torch.ones(5, 5, 1, 40, 44)
    weight[1, 2, 0, 10:14, 20:23] = 0
    views = torch.where(weight > 0, torch.rand(5, 5, 3, 40, 44), 0)
    refocuser = OperatorRefocuser(name, EVERY[name])
    expected = refocuser(LightField(views, weight=weight), [0.3])
    wild = LightField(views.masked_fill(weight == 0, torch.nan), weight=weight)
    assert torch.equal(refocuser(wild, [0.3]), expected)


def test_another_aperture_makes_another_refocuser_unless_it_has_one_of_its_own():
    light, plain = weighted_field(), OperatorRefocuser("name", exact_fourier)
    round_one = plain.through(apertures.disc)
    weights = apertures.disc((3, 3))
    assert torch.equal(round_one(light, FOCI), exact_fourier(light.views, FOCI, weights=weights))
    assert round_one.name == "name"
    assert plain.aperture is None
    assert plain.through(None) is plain
    assert round_one.through(apertures.full) is round_one


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


@pytest.mark.parametrize("name", ["separable", "aware"])
def test_views_of_some_weight_are_read_as_they_are_by_methods_of_symmetric_weights(name):
    views, weights = torch.rand(5, 5, 3, 40, 44), torch.ones(5, 5)
    weights[0, 1] = 0.5
    sampled = LightField(views, weight=weights[:, :, None, None, None].expand(5, 5, 1, 40, 44))
    assert torch.equal(OperatorRefocuser(name, EVERY[name])(sampled, [0.4]), EVERY[name](views, [0.4]))
    refocuser = OperatorRefocuser(name, EVERY[name], apertures.disc)
    expected = EVERY[name](views, [0.4], weights=apertures.disc((5, 5)))
    assert torch.equal(refocuser(sampled, [0.4]), expected)


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


@pytest.mark.parametrize("name", ["layers", "aware", "slice"])
def test_methods_of_even_grids_name_others_for_cameras_elsewhere(name):
    uneven = LightField(torch.rand(3, 3, 3, 14, 15), positions=batches.even((3, 3)) * 1.2)
    with pytest.raises(InputError):
        OperatorRefocuser(name, EVERY[name])(uneven, FOCI)


ROUNDED = EVERY | {"cubic": functools.partial(shift_and_sum, interpolation="cubic")}


def with_black_corners(views):
    """A field whose samples beyond a slanted line count for nothing, as in the corners of a lens."""
    height, width = views.shape[-2:]
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    is_seen = (y + 2 * x > 24)[None].expand(*views.shape[:2], 1, height, width)
    return LightField(torch.where(is_seen, views, 0.0), weight=is_seen.to(views))


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
