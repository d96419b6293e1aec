"""Reference formulas against mpmath, the definition of SSIM and slow loops."""

import math

import mpmath
import numpy as np
import pytest
import torch

from lfref.bench.stability import reference_formulas as reference
from lfref.bench.stability.catalogue import noise
from lfref.geometry import angular_offsets


@pytest.mark.parametrize(("mean", "contrast"), [(0.5, 0.4), (64, 0.01), (1000, 0.001), (0, 1e-6)])
def test_ssim_is_its_definition_in_50_digits(mean, contrast):
    x, y = ((mean + contrast * noise(1, 1, 7, 8, seed=seed)).float().double() for seed in (0, 1))
    assert float(reference.one_minus_ssim(x, y)) == pytest.approx(
        float(slow_one_minus_ssim(x[0, 0], y[0, 0])), abs=1e-13
    )


def slow_one_minus_ssim(x, y):
    """1 less the mean of the textbook SSIM, a window at a time."""
    with mpmath.workdps(50):
        taps = [mpmath.exp(mpmath.mpf(-(k**2)) / 4.5) for k in range(-5, 6)]
        taps = [tap / mpmath.fsum(taps) for tap in taps]
        values = [slow_pixel(x.tolist(), y.tolist(), i, j, taps) for i in range(x.shape[0]) for j in range(x.shape[1])]
        return 1 - mpmath.fsum(values) / len(values)


def slow_pixel(x, y, i, j, taps):
    c1, c2 = mpmath.mpf("1e-4"), mpmath.mpf("9e-4")
    height, width = len(x), len(x[0])
    window = [
        (taps[k + 5] * taps[m + 5], reflected(i + k, height), reflected(j + m, width))
        for k in range(-5, 6)
        for m in range(-5, 6)
    ]

    def mean(value):
        return mpmath.fsum(w * value(mpmath.mpf(x[a][b]), mpmath.mpf(y[a][b])) for w, a, b in window)

    mx, my = mean(lambda p, q: p), mean(lambda p, q: q)
    vx, vy, cov = mean(lambda p, q: p * p) - mx**2, mean(lambda p, q: q * q) - my**2, mean(lambda p, q: p * q) - mx * my
    return (2 * mx * my + c1) * (2 * cov + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))


def reflected(index, length):
    return length - 1 - abs(length - 1 - abs(index))


@pytest.mark.parametrize("decibel", [8.6859, 20, 55.5, 100])
def test_inverse_psnr_is_the_papers_inside(decibel):
    x = torch.full((1, 1, 1, 1), 10 ** (-decibel / 20), dtype=torch.float64)
    with mpmath.workdps(50):
        right = 1 / (-10 * mpmath.log10(mpmath.mpf(float(x)) ** 2))
    assert float(reference.inverse_psnr(x, torch.zeros_like(x))) == pytest.approx(float(right), rel=1e-14)


@pytest.mark.parametrize("end", [reference.FLOOR, reference.JOIN])
def test_inverse_psnr_goes_on_along_the_tangent(end):
    def f(m):
        return float(
            reference.inverse_psnr(torch.full((1, 1, 1), math.sqrt(m), dtype=torch.float64), torch.zeros(1, 1, 1))
        )

    step = end * 1e-4
    slopes = [(f(end + sign * step) - f(end)) / (sign * step) for sign in (1, -1)]
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-3)
    outside = 0 if end == reference.FLOOR else 100
    expected = f(end) + slopes[outside == 0] * (outside - end)
    assert f(outside) == pytest.approx(expected, rel=1e-3)


def slow_plane(views, slope, weights, kernel, border):
    """The mean of views read sample by sample; samples beyond the edge by the border's rule."""
    n_rows, n_columns, height, width = views.shape
    total, covered = np.zeros((height, width)), np.zeros((height, width))
    for v, u, y, x in np.ndindex(n_rows, n_columns, height, width):
        at_y, at_x = (p + slope * float(angular_offsets(n)[i]) for p, n, i in ((y, n_rows, v), (x, n_columns, u)))
        if border == "renormalize" and not (0 <= at_y <= height - 1 and 0 <= at_x <= width - 1):
            continue
        covered[y, x] += weights[v, u]
        for row in range(math.floor(at_y) - 2, math.floor(at_y) + 4):
            for column in range(math.floor(at_x) - 2, math.floor(at_x) + 4):
                tap = kernel(at_y - row) * kernel(at_x - column)
                total[y, x] += (
                    weights[v, u]
                    * tap
                    * views[v, u][sample_index(row, height, border), sample_index(column, width, border)]
                )
    return np.divide(total, covered, out=np.zeros_like(total), where=covered > 0)


def sample_index(index, length, border):
    return index % length if border == "wrap" else min(max(index, 0), length - 1)


def hat(distance):
    return max(0.0, 1 - abs(distance))


def keys(distance):
    d = abs(distance)
    inner, outer = 1.5 * d**3 - 2.5 * d**2 + 1, -0.5 * d**3 + 2.5 * d**2 - 4 * d + 2
    return inner if d <= 1 else outer if d < 2 else 0.0


@pytest.mark.parametrize("border", ["wrap", "edge", "renormalize"])
@pytest.mark.parametrize(("interpolation", "kernel"), [("linear", hat), ("cubic", keys)])
def test_refocusing_by_matrices_is_a_slow_loop(interpolation, kernel, border):
    views, weights = noise(2, 3, 1, 6, 7), 1 + 0.5 * noise(2, 3, seed=1)
    slopes = torch.tensor([0.0, -1.3, 2.0], dtype=torch.float64)
    stack = reference.refocused(views, slopes, weights, interpolation, border)
    for slope, stack_plane in zip(slopes.tolist(), stack[:, 0], strict=True):
        np.testing.assert_allclose(
            stack_plane, slow_plane(views[:, :, 0].numpy(), slope, weights, kernel, border), atol=1e-12
        )


@pytest.mark.parametrize("size", [(6, 7), (5, 8)])
def test_exact_refocusing_moves_waves_by_any_fraction(size):
    x, shift = torch.arange(size[1], dtype=torch.float64), 0.37
    slopes, second = torch.tensor([2 * shift], dtype=torch.float64), torch.tensor([[0.0, 1.0]], dtype=torch.float64)
    for k in (1, 2):
        wave, moved = (torch.cos(2 * math.pi * k * at / size[1]).expand(*size) for at in (x, x + shift))
        stack_plane = reference.refocused(torch.stack([wave, wave])[None, :, None], slopes, second)[0, 0]
        torch.testing.assert_close(stack_plane, moved, atol=1e-12, rtol=0)


def test_nearest_takes_the_upper_of_two_and_dead_views_are_not_read():
    views = noise(1, 2, 1, 4, 6)
    views[0, 0] = math.nan
    stack_plane = reference.refocused(views, torch.tensor([1.0]), torch.tensor([[0.0, 2.0]]), "nearest")
    torch.testing.assert_close(stack_plane[0], views[0, 1].roll(-1, -1))
