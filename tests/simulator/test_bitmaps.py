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

CANVAS = Canvas(-80, -80, 160, 160, (80, 80))


def noise():
    return Bitmap(CANVAS, Noise(exponent=1.0).paint(CANVAS, (0,)))


def box_blurred(bitmap, width):
    """The box carried out on the spectrum; the canvas holds one period of the noise."""
    gains = [torch.sinc(2 * width * f) for f in (exact.frequencies(160)[:, None], exact.half_frequencies(160))]
    return torch.fft.irfft2(torch.fft.rfft2(bitmap.samples.double()) * gains[0] * gains[1], s=(160, 160))


def read(bitmap, width, i, j):
    """Linear look-ups between the two copies that stand for a blur."""
    # Over all fractions alike a linear look-up has a variance of 1/6.
    (place,) = bitmaps.levels(np.array([(2 * width) ** 2 / 12 - 1 / 6]))
    level = int(place)
    parts = []
    for n in (level, level + 1):
        parts.append(bitmaps.linear_at(bitmap.blurred(n).movedim(-1, 0), i + bitmaps.margin(n), j + bitmaps.margin(n)))
    return torch.lerp(parts[0], parts[1], place - level)


def scattered(n=41):
    """Every pixel, at all fractions of samples alike."""
    i, j = torch.meshgrid(*2 * [torch.arange(n, dtype=torch.float64) * 2 + 40], indexing="ij")
    shares = torch.rand(2, n, n, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return i + shares[0], j + shares[1]


@pytest.mark.parametrize("width", [0.6, 1.0, 2.0, 3.5, 6.0, 9.0])
def test_a_blur_is_a_box_of_that_width(width):
    bitmap = noise()
    i, j = scattered()
    expected = bitmaps.cubic_at(box_blurred(bitmap, width).float(), i, j)
    error = (read(bitmap, width, i, j) - expected).square().mean()
    assert float(-10 * error.log10()) > 50


def test_the_sharpened_copy_undoes_what_linear_look_ups_blur_midway():
    bitmap = noise()
    i, j = scattered()
    i, j = i.floor() + 0.5, j.floor() + 0.5
    exact = bitmaps.cubic_at(bitmap.samples, i, j)
    errors = [
        (bitmaps.linear_at(bitmap.blurred(level).movedim(-1, 0), i + beyond, j + beyond) - exact).square().mean()
        for level, beyond in ((0, 1), (1, 0))
    ]
    assert float(errors[0]) < 0.1 * float(errors[1])


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
    point = torch.zeros(1, 61, 60)
    point[:, 30, 30] = 1
    bitmap = Bitmap(Canvas(-30, -30, 60, 61, (30, 30)), point)
    for level in range(7):
        spot = bitmap.blurred(level)[..., 0].sum(0).double()
        places = torch.arange(len(spot)) - 30 - bitmaps.margin(level)
        assert float((spot * places**2).sum()) == pytest.approx(bitmaps.variance(level), abs=1e-5)


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
    read = bitmaps.cubic_at(quadratic(i, j)[None], at_i, at_j)
    torch.testing.assert_close(read[:, 0], quadratic(at_i, at_j).float(), atol=2e-6, rtol=0)


def test_grids_are_read_as_points_are_within_and_beyond_the_bitmap():
    samples = torch.rand(4, 20, 24)
    i, j = torch.rand(3, 1, 30, dtype=torch.float64) * 40 - 8, torch.rand(3, 25, 1, dtype=torch.float64) * 40 - 8
    points = bitmaps.cubic_at(samples, i.expand(3, 25, 30), j.expand(3, 25, 30))
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


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_linear_look_ups_go_on_beyond_the_ends(kind):
    random = np.random.default_rng(0)
    samples = random.random((7, 9, 4)).astype(kind)
    i, j = random.uniform(-4, 14, (2, 200))
    i[:3], j[:3] = (0, 8, 5), (6, 0, 2.5)
    row = np.concatenate([np.full(5, np.nan, kind), samples.reshape(-1)])
    result = np.stack([bitmaps.linear_sample(row, 5, 7, 9, *point) for point in zip(i, j, strict=True)], 1)
    places = torch.from_numpy(i)[None, None], torch.from_numpy(j)[None, None]
    expected = bitmaps.linear_at(torch.from_numpy(samples).movedim(-1, 0), *places)[0, :, 0]
    np.testing.assert_allclose(result, expected, atol=1e-6)
    at_sample = samples[2, 5] / 2 + samples[3, 5] / 2
    np.testing.assert_allclose(result[:, 2], at_sample, atol=1e-6)


SIDE = st.floats(-500, 500)


@given(SIDE, SIDE, st.floats(0, 300), st.floats(0, 300))
def test_a_canvas_covers_its_box_in_half_pixels(left, top, width, height):
    canvas = bitmaps.covering((left, top, left + width, top + height), (8, 8))
    for axis, first, length in ((canvas.x, left, width), (canvas.y, top, height)):
        assert float(axis[0]) <= first
        assert float(axis[-1]) >= first + length
        assert float(axis[-1] - axis[0]) <= length + 1.5
        assert bool((axis * bitmaps.OVERSAMPLING == (axis * bitmaps.OVERSAMPLING).round()).all())
    assert canvas.width % 2 == 0
    assert (len(canvas.y), len(canvas.x)) == (canvas.height, canvas.width)


@pytest.mark.parametrize(("length", "fast"), [(1, 2), (7, 8), (13, 16), (205, 216), (255.5, 256), (300, 300)])
def test_lengths_are_rounded_up_to_quick_even_ones(length, fast):
    assert bitmaps.fast_length(length) == fast
    assert torch.fft.rfft(torch.zeros(fast)).numel() == fast // 2 + 1
