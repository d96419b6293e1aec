"""Super-resolved refocus: more detail where views sample one surface, the plane of exact refocusing elsewhere."""

import dataclasses

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from lfref.refocus.fourier import super_resolution
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.super_resolution import super_resolve
from lfref.simulator import sim30
from lfref.simulator import simulate as finer
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.scene import Camera
from lfref.simulator.simulate import simulate

MARGIN = 12


def decibels(image, truth, margin=MARGIN):
    inner = (..., slice(margin, -margin), slice(margin, -margin))
    return float(-10 * (image[inner] - truth[inner]).square().mean().log10())


def photographed(name, slopes, size=(64, 96)):
    """Views of a scene of sim30 whose textures alias, and the truth on the views' grid and on one twice as fine."""
    (scene,) = sim30.scenes(name, version=2).scenes
    scene = dataclasses.replace(scene, camera=Camera(size=size, samples=2), sensor=Sensor())
    fine = simulate(finer.finer(scene, 2), 0, ["truth"], 2 * torch.tensor(slopes, dtype=torch.float64)).truth
    views = simulate(scene, 0, ["views"]).views
    return views, finer.averaged(fine, 2), fine


@pytest.mark.parametrize(("name", "slope", "gain"), [("plane", -1 / 3, 12), ("stripes", -0.6, 30), ("shards", -0.3, 3)])
def test_at_the_slope_of_a_texture_bicubic_is_beaten_by_3_db_and_more(name, slope, gain):
    views, coarse, truth = photographed(name, [slope])
    exact, fine = exact_fourier(views, [slope]), super_resolve(views, [slope])
    bicubic = F.interpolate(exact, scale_factor=2, mode="bicubic")
    assert decibels(fine, truth, 2 * MARGIN) > decibels(bicubic, truth, 2 * MARGIN) + gain
    assert decibels(finer.averaged(fine, 2), coarse) > decibels(exact, coarse) + 1


@pytest.mark.parametrize("factor", [1, 2, 3])
def test_out_of_focus_it_is_the_exact_plane_and_no_more(factor):
    views, _, _ = photographed("stripes", [0.0], (48, 60))
    plane = super_resolution.band_limited(exact_fourier(views, [0.7]), factor)
    torch.testing.assert_close(super_resolve(views, [0.7], factor), plane, atol=1e-5, rtol=0)


@pytest.mark.parametrize("factor", [1, 2, 4])
@pytest.mark.parametrize("slope", [0.0, 1.0, 0.37, -1.9])
def test_brightness_is_kept_everywhere(factor, slope):
    views = torch.full((3, 5, 1, 14, 15), 0.7, dtype=torch.float64)
    stack = super_resolve(views, [slope], factor)
    torch.testing.assert_close(stack, torch.full_like(stack, 0.7), atol=1e-9, rtol=0)


def slow_views(fine, slope, grid, factor):
    """Means over r x r pixels of the picture shifted, frequency by frequency; [V, U, H, W]."""
    rows, columns = (slow_axis(length, factor, slope, n) for length, n in zip(fine.shape, grid, strict=True))
    return np.einsum("vyY,uxX,YX->vuyx", rows, columns, fine).real


def slow_axis(length, factor, slope, n_views):
    """Matrices from fine pixels to each view's along one axis; [V, length / r, length]."""
    k = np.fft.fftfreq(length)
    x = np.arange(length)
    shifts = factor * slope * (np.arange(n_views) - (n_views - 1) / 2)
    shifted = np.stack([np.exp(2j * np.pi * k * (x[:, None] - shift)) for shift in shifts])
    spectrum = np.exp(-2j * np.pi * k[:, None] * x) / length
    return (shifted @ spectrum).reshape(n_views, length // factor, factor, length).mean(2)


@pytest.mark.parametrize("factor", [1, 2, 3])
@pytest.mark.parametrize("slope", [0.37, -1.2])
def test_views_of_a_fine_picture_are_those_of_the_definition(factor, slope):
    fine = np.random.default_rng(0).random((7 * factor, 5 * factor))
    views = super_resolution.predicted_views(torch.from_numpy(fine), slope, factor, (3, 4))
    np.testing.assert_allclose(views.numpy(), slow_views(fine, slope, (3, 4), factor), atol=1e-12)


@pytest.mark.parametrize("size", [(7, 9), (6, 8)])
def test_minimises_the_squared_errors_and_the_penalty(size):
    """The gradient of the objective, by automatic differentiation of its definition, is 0 there."""
    slope, factor, weights = 0.3, 2, torch.rand(3, 4, dtype=torch.float64)
    weights /= weights.sum()
    views = torch.rand(3, 4, 1, *size, dtype=torch.float64)
    picture = super_resolution.in_focus(views[None], slope, factor, weights)[0, 0].requires_grad_()
    errors = (super_resolution.predicted_views(picture, slope, factor, (3, 4)) - views[:, :, 0]).square().sum((-2, -1))
    objective = (weights * errors).sum() + penalty(picture, factor)
    (gradient,) = torch.autograd.grad(objective, picture)
    assert float(gradient.abs().max()) < 1e-9


def penalty(fine, factor):
    rows, columns = (factor * torch.fft.fftfreq(length, dtype=torch.float64) for length in fine.shape)
    lowest = [((q + 0.5) % 1 - 0.5).abs() for q in (rows, columns)]
    ratio = (rows[:, None] ** 2 + columns**2 + 0.01**2) / (lowest[0][:, None] ** 2 + lowest[1] ** 2 + 0.01**2)
    is_tied = ((lowest[0] == 0.5)[:, None] | (lowest[1] == 0.5)) & (ratio < 1 + 1e-9)
    power = torch.fft.fft2(fine).abs().square() / fine.numel()
    return ((0.03 * (ratio**1.25 - 1) + 0.001 * is_tied) * power).sum() / factor**2
