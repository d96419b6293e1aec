"""Canvases cover boxes, look-ups reproduce polynomials, and blurred copies are boxes of matched variance."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lfref.refocus.fourier import exact
from lfref.simulator import bitmaps
from lfref.simulator.bitmaps import Bitmap, Canvas
from lfref.simulator.textures import Noise
from tests.simulator import eager

CANVAS = Canvas(-80, -80, 160, 160, (80, 80))


def noise():
    colours = Noise(exponent=1.0).paint(CANVAS, (0,))
    return Bitmap(CANVAS, torch.cat([colours, torch.ones(1, 160, 160)]))


def box_blurred(bitmap, width):
    """The box carried out on the spectrum; the canvas holds one period of the noise."""
    gains = [torch.sinc(2 * width * f) for f in (exact.frequencies(160)[:, None], exact.half_frequencies(160))]
    return torch.fft.irfft2(torch.fft.rfft2(bitmap.samples.double()) * gains[0] * gains[1], s=(160, 160))


def read(bitmap, width, i, j):
    """Linear look-ups between the two copies that stand for a blur, at columns i and rows j of the bitmap."""
    # Over all fractions alike a linear look-up has a variance of 1/6.
    (place,) = bitmaps.levels(np.array([(bitmaps.FINE * width) ** 2 / 12 - 1 / 6]))
    level = int(place)
    return torch.lerp(read_copy(bitmap, level, i, j), read_copy(bitmap, level + 1, i, j), place - level)


def read_copy(bitmap, level, i, j):
    beyond = bitmaps.margin(level)
    return eager.linear_at(bitmap.blurred(level).movedim(-1, 0), 2 * i + beyond, 2 * j + beyond)


def scattered(n=41):
    """Every pixel, at all fractions of samples alike."""
    i, j = torch.meshgrid(*2 * [torch.arange(n, dtype=torch.float64) * 2 + 40], indexing="ij")
    shares = torch.rand(2, n, n, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return i + shares[0], j + shares[1]


@pytest.mark.parametrize("width", [0.6, 1.0, 2.0, 3.5, 6.0, 9.0])
def test_a_blur_is_a_box_of_that_width(width):
    bitmap = noise()
    i, j = scattered()
    expected = eager.cubic_at(box_blurred(bitmap, width).float(), i, j)
    error = (read(bitmap, width, i, j) - expected).square().mean()
    assert float(-10 * error.log10()) > 50


def test_the_sharpened_copy_undoes_what_linear_look_ups_blur_midway():
    bitmap = noise()
    i, j = scattered()
    i, j = i.floor() + 0.25, j.floor() + 0.25  # midway between refined samples
    exact = eager.cubic_at(bitmap.samples, i, j)
    errors = [(read_copy(bitmap, level, i, j) - exact).square().mean() for level in (0, 1)]
    assert float(errors[0]) < 0.1 * float(errors[1])


def test_refined_samples_are_what_views_read_there():
    random = torch.Generator().manual_seed(2)
    samples = torch.rand(4, 7, 10, generator=random)
    samples[:3] *= samples[3]
    samples[3, 2:4, 3:6] = 1  # overshoots beside
    rows, columns = (torch.arange(2 * length, dtype=torch.float64) / 2 for length in (7, 10))
    inner = (slice(None), slice(2, -4), slice(2, -4))  # beyond its ends views read a bitmap as transparent
    expected = bitmaps.clip_premultiplied(bitmaps.cubic_on_grid(samples, columns[None, None], rows[None, :, None])[0])
    torch.testing.assert_close(bitmaps.refined(samples)[inner], expected[inner], atol=1e-6, rtol=0)


@pytest.mark.parametrize("size", [1, 3, 9, 41])
@pytest.mark.parametrize("shape", [(12, 15), (3, 50)])
def test_boxes_are_means_of_what_goes_on_beyond_the_ends(size, shape):
    samples = torch.rand(*shape, 4)
    half = size - 1
    padded = torch.nn.functional.pad(samples.movedim(-1, 0)[None].double(), (half,) * 4, mode="replicate")
    expected = torch.nn.functional.avg_pool2d(padded, size, 1)[0].movedim(0, -1)
    torch.testing.assert_close(bitmaps.box_blurred(samples, size).double(), expected, atol=1e-6, rtol=0)
    eager = bitmaps._running_mean(bitmaps._running_mean(samples, size, 0), size, 1)
    torch.testing.assert_close(eager.double(), expected, atol=1e-6, rtol=0)


def test_variances_are_those_of_the_copies():
    i = torch.arange(61.0) - 30
    spot = torch.exp(-(i**2) / 8)
    bitmap = Bitmap(Canvas(-30, -30, 60, 61, (30, 30)), (spot[:, None] * spot[:60]).expand(4, -1, -1))

    def moment(samples, beyond):
        profile = samples[..., 0].sum(0).double()
        return float((profile * (torch.arange(len(profile)) - 60 - beyond) ** 2).sum() / profile.sum())

    sharp = moment(bitmaps.refined(bitmap.samples).movedim(0, -1), 0)
    for level in range(7):
        widened = moment(bitmap.blurred(level), bitmaps.margin(level)) - sharp
        assert widened == pytest.approx(bitmaps.variance(level), abs=1e-3)


def test_levels_go_up_with_the_width_without_a_jump():
    places = bitmaps.levels(np.linspace(0, 60, 2000) ** 2 / 12 - bitmaps.LINEAR_VARIANCE)
    assert places[0] == 0
    assert 0 <= np.diff(places).min() <= np.diff(places).max() < 0.1


@pytest.mark.parametrize("width", [0.0, 0.7, 5.0, 70.0])
def test_a_constant_stays(width):
    bitmap = Bitmap(CANVAS, torch.full((4, 160, 160), 0.7))
    i, j = scattered()
    torch.testing.assert_close(read(bitmap, width, i, j), torch.full((4, 41, 41), 0.7), atol=1e-6, rtol=0)


def quadratic(i, j):
    return 0.3 + 0.02 * i - 0.01 * j + 0.001 * i**2 - 0.002 * i * j + 0.0015 * j**2


@given(st.floats(0, 1))
def test_weights_add_up_to_one_and_reproduce_quadratics(t):
    weights = bitmaps.cubic_weights(torch.tensor(t, dtype=torch.float64))
    offsets = torch.tensor([-1.0, 0.0, 1.0, 2.0], dtype=torch.float64)
    for power in range(3):
        assert abs(float((weights * offsets**power).sum()) - t**power) < 1e-12


def test_quadratics_are_read_exactly():
    j, i = torch.meshgrid(torch.arange(20.0), torch.arange(24.0), indexing="ij")
    at_i, at_j = torch.rand(2, 5, 6, 7, dtype=torch.float64) * 15 + 2
    read = eager.cubic_at(quadratic(i, j)[None], at_i, at_j)
    torch.testing.assert_close(read[:, 0], quadratic(at_i, at_j).float(), atol=2e-6, rtol=0)


def test_grids_are_read_as_points_are_within_and_beyond_the_bitmap():
    samples = torch.rand(4, 20, 24)
    i, j = torch.rand(3, 1, 30, dtype=torch.float64) * 40 - 8, torch.rand(3, 25, 1, dtype=torch.float64) * 40 - 8
    points = eager.cubic_at(samples, i.expand(3, 25, 30), j.expand(3, 25, 30))
    torch.testing.assert_close(bitmaps.cubic_on_grid(samples, i, j), points, atol=1e-6, rtol=0)


def test_far_beyond_its_ends_a_bitmap_goes_on():
    samples = torch.rand(4, 20, 24)
    far = torch.tensor([[[-1e6, 1e6]]], dtype=torch.float64)
    read = bitmaps.cubic_on_grid(samples, far, far.mT)[0]
    torch.testing.assert_close(read, samples[:, [0, -1]][..., [0, -1]])


def test_legal_colours_are_positive_and_no_more_opaque_than_one():
    rgba = torch.tensor([[0.5, 0.3], [-0.1, 0.2], [1.2, 0.0], [1.25, -0.1]])[None, :, None]
    expected = torch.tensor([[0.4, 0.0], [0.0, 0.0], [0.96, 0.0], [1.0, 0.0]])[None, :, None]
    torch.testing.assert_close(bitmaps.clip_premultiplied(rgba), expected)
