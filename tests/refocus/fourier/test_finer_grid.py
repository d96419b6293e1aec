"""The finer picture: least squares as in its definition, detail that comes back, planes that do not change."""

import math

import numpy as np
import pytest
import torch

from lfref.refocus.fourier import super_resolution
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.super_resolution import in_focus

SIDE = 12


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
    seen = super_resolution.seen(torch.from_numpy(fine), slope, factor, (3, 4))
    np.testing.assert_allclose(seen.numpy(), slow_views(fine, slope, (3, 4), factor), atol=1e-12)


@pytest.mark.parametrize(("slope", "factor"), [(0.37, 2), (-0.3, 2), (0.5, 2), (1 / 3, 3), (0.21, 3)])
def test_a_picture_comes_back_from_its_views(slope, factor, monkeypatch):
    monkeypatch.setattr(super_resolution, "RIDGE", 1e-9)
    fine = torch.rand(SIDE * factor - factor, SIDE * factor + factor, dtype=torch.float64)
    fine = without_highest(fine, factor)
    views = super_resolution.seen(fine, slope, factor, (7, 7))[:, :, None]
    torch.testing.assert_close(in_focus(views, [slope], factor)[0, 0], fine, atol=1e-3, rtol=0)


def without_highest(fine, factor):
    """The picture without the frequencies that means over r pixels leave nothing of."""
    for axis in (0, 1):
        length = fine.shape[axis] // factor
        spectrum = torch.fft.fft(fine, dim=axis)
        q = torch.arange(factor * length)
        is_lost = ((q % length == 0) & (q > 0)) | (2 * q == factor * length)
        spectrum[is_lost.nonzero()[:, 0] if axis == 0 else (slice(None), is_lost.nonzero()[:, 0])] = 0
        fine = torch.fft.ifft(spectrum, dim=axis).real
    return fine


def test_minimises_the_squared_errors_and_the_penalty():
    """The gradient of the objective, by automatic differentiation of its definition, is 0 there."""
    slope, factor, weights = 0.3, 2, torch.rand(3, 4, dtype=torch.float64)
    weights /= weights.sum()
    views = torch.rand(3, 4, 1, 7, 9, dtype=torch.float64)
    found = in_focus(views, [slope], factor, weights)[0, 0].requires_grad_()
    errors = (super_resolution.seen(found, slope, factor, (3, 4)) - views[:, :, 0]).square().sum((-2, -1))
    objective = (weights * errors).sum() + penalty(found, factor)
    (gradient,) = torch.autograd.grad(objective, found)
    assert float(gradient.abs().max()) < 1e-9


def penalty(fine, factor):
    rows, columns = (factor * torch.fft.fftfreq(length, dtype=torch.float64) for length in fine.shape)
    squares = rows[:, None] ** 2 + columns**2 + super_resolution.OUTER**2
    lowest = [((q + 0.5) % 1 - 0.5) ** 2 for q in (rows, columns)]
    ratio = squares / (lowest[0][:, None] + lowest[1] + super_resolution.OUTER**2)
    power = torch.fft.fft2(fine).abs().square() / fine.numel()
    return (super_resolution.RIDGE * (ratio ** (super_resolution.DECAY / 2) - 1) * power).sum() / factor**2


@pytest.mark.parametrize("factor", [2, 3])
@pytest.mark.parametrize("size", [(8, 10), (7, 9)])
def test_band_limited_planes_keep_their_means(factor, size):
    plane = torch.rand(2, *size, dtype=torch.float64)
    means = (
        super_resolution.band_limited(plane, factor)
        .unfold(-2, factor, factor)
        .unfold(-2, factor, factor)
        .mean((-2, -1))
    )
    torch.testing.assert_close(means, plane, atol=1e-12, rtol=0)


def test_a_wave_stays_a_wave_on_the_finer_grid():
    x = (torch.arange(40, dtype=torch.float64) + 0.5) / 2 - 0.5
    wave = (2 * math.pi * 0.15 * x).cos().expand(20, -1)
    means = wave.unfold(-1, 2, 2).mean(-1)
    torch.testing.assert_close(
        super_resolution.band_limited(means, 2), wave.repeat_interleave(2, 0), atol=1e-12, rtol=0
    )


def test_one_view_or_whole_slopes_tell_no_more_than_the_exact_plane_where_it_is_strong():
    views = torch.rand(3, 3, 1, 9, 9, dtype=torch.float64)
    found = super_resolution.in_focus(views, [0.0], 2)
    means = found.unfold(-2, 2, 2).unfold(-2, 2, 2).mean((-2, -1))
    torch.testing.assert_close(means, exact_fourier(views, [0.0]), atol=0.02, rtol=0)
