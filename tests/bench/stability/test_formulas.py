"""Reference formulas against SSIM in 50 digits, tangents and waves; textbook forms on benign input."""

import math

import mpmath
import pytest
import torch

from lfref.bench.stability import catalogue, formulas
from lfref.bench.stability.catalogue import noise


@pytest.mark.parametrize(("mean", "contrast"), [(0.5, 0.4), (64, 0.01), (1000, 0.001), (0, 1e-6)])
def test_ssim_is_its_definition_in_50_digits(mean, contrast):
    x, y = ((mean + contrast * noise(1, 1, 7, 8, seed=seed)).float().double() for seed in (0, 1))
    assert float(formulas.one_minus_ssim(x, y)) == pytest.approx(
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


@pytest.mark.parametrize("end", [formulas.FLOOR, formulas.JOIN])
def test_inverse_psnr_goes_on_along_the_tangent(end):
    def f(m):
        return float(
            formulas.inverse_psnr(torch.full((1, 1, 1), math.sqrt(m), dtype=torch.float64), torch.zeros(1, 1, 1))
        )

    step = end * 1e-4
    slopes = [(f(end + sign * step) - f(end)) / (sign * step) for sign in (1, -1)]
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-3)
    outside = 0 if end == formulas.FLOOR else 100
    expected = f(end) + slopes[outside == 0] * (outside - end)
    assert f(outside) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("size", [(6, 7), (5, 8)])
def test_exact_refocusing_moves_waves_by_any_fraction(size):
    x, shift = torch.arange(size[1], dtype=torch.float64), 0.37
    slopes, second = torch.tensor([2 * shift], dtype=torch.float64), torch.tensor([[0.0, 1.0]], dtype=torch.float64)
    for k in (1, 2):
        wave, moved = (torch.cos(2 * math.pi * k * at / size[1]).expand(*size) for at in (x, x + shift))
        stack_plane = formulas.refocused(torch.stack([wave, wave])[None, :, None], slopes, second)[0, 0]
        torch.testing.assert_close(stack_plane, moved, atol=1e-12, rtol=0)


@pytest.mark.parametrize("name", ["psnr", "inverse_psnr", "one_minus_ssim", "composite"])
def test_textbook_forms_are_right_on_benign_images(name):
    pair = catalogue.IMAGES[0].make(torch.float32)
    right = getattr(formulas, name)(*(image.double() for image in pair))
    torch.testing.assert_close(getattr(formulas, f"textbook_{name}")(*pair).double(), right, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(
    ("form", "options"),
    [(formulas.grid_sample, {"interpolation": "linear", "border": "edge"}), (formulas.phase_ramps, {})],
)
def test_textbook_operators_are_right_on_benign_views(form, options):
    field = catalogue.FIELDS[0].make(torch.float32)
    right = formulas.refocused(*(part.double() for part in field), **options)
    torch.testing.assert_close(form(*field).double(), right, atol=1e-5, rtol=0)
