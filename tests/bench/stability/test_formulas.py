"""Reference formulas against SSIM in long doubles, tangents and waves; textbook forms on benign input."""

import math

import numpy as np
import pytest
import torch

from lfref.bench.stability import catalogue, formulas
from lfref.bench.stability.catalogue import noise


@pytest.mark.parametrize(("mean", "contrast"), [(0.5, 0.4), (64, 0.01), (1000, 0.001), (0, 1e-6)])
def test_ssim_is_its_definition_in_long_doubles(mean, contrast):
    x, y = ((mean + contrast * noise(1, 1, 7, 8, seed=seed)).float().double() for seed in (0, 1))
    right = slow_one_minus_ssim(*(image[0, 0].numpy().astype(np.longdouble) for image in (x, y)))
    assert float(formulas.one_minus_ssim(x, y)) == pytest.approx(float(right), abs=1e-9)


def slow_one_minus_ssim(x, y):
    """1 less the mean of the textbook SSIM over Gaussian windows of reflected pictures."""
    taps = np.exp(-(np.arange(-5, 6, dtype=np.longdouble) ** 2) / 4.5)
    taps = np.outer(taps, taps) / taps.sum() ** 2

    def mean(image):
        windows = np.lib.stride_tricks.sliding_window_view(np.pad(image, 5, mode="reflect"), (11, 11))
        return (windows * taps).sum((-2, -1))

    mx, my = mean(x), mean(y)
    vx, vy, cov = mean(x * x) - mx**2, mean(y * y) - my**2, mean(x * y) - mx * my
    c1, c2 = np.longdouble(1) / 10000, np.longdouble(9) / 10000
    return 1 - ((2 * mx * my + c1) * (2 * cov + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))).mean()


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
