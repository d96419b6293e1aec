"""Effects of recording: mosaics as the library makes them, noise of the model's variance, steps and standard curves."""

import numpy as np
import OpenImageIO
import pytest
import torch

from lfref.simulator.effects.recording import (
    PATTERNS,
    Clipping,
    Exposure,
    Noise,
    Quantisation,
    ToneCurve,
    WhiteBalance,
    demosaicked,
    mosaicked,
    noisy,
)
from tests.simulator.drawing import applied


@pytest.mark.parametrize("pattern", list(PATTERNS))
@pytest.mark.parametrize("size", [(8, 10), (7, 9), (3, 3)])
def test_the_pattern_spells_what_is_kept_and_a_constant_stays_up_to_the_edge(pattern, size):
    views = torch.rand(2, 2, 3, *size)
    raw = mosaicked(views, pattern)
    for y in range(size[0]):
        for x in range(size[1]):
            channel = "RGB".index(pattern[2 * (y % 2) + x % 2])
            assert torch.equal(raw[:, :, 0, y, x], views[:, :, channel, y, x])
    assert torch.equal(mosaicked(demosaicked(raw, pattern), pattern), raw)
    even = torch.tensor([0.2, 0.9, 0.4])[:, None, None].expand(2, 1, 3, *size)
    torch.testing.assert_close(demosaicked(mosaicked(even, pattern), pattern), even, atol=1e-6, rtol=0)


@pytest.mark.parametrize("pattern", list(PATTERNS))
def test_ramps_of_all_colours_are_exact_inside(pattern):
    y, x = torch.arange(11, dtype=torch.float64)[:, None], torch.arange(12, dtype=torch.float64)
    views = torch.stack([0.1 * x - 0.2 * y + 3, 0.3 * x + 0.05 * y, 1 - 0.07 * x + 0.4 * y])[None, None]
    result = demosaicked(mosaicked(views, pattern), pattern)
    torch.testing.assert_close(result[..., 2:-2, 2:-2], views[..., 2:-2, 2:-2], atol=1e-12, rtol=0)


@pytest.mark.parametrize("pattern", list(PATTERNS))
def test_demosaicing_is_that_of_openimageio(pattern):
    raw = torch.rand(1, 1, 1, 12, 14)
    image = OpenImageIO.ImageBuf(raw[0, 0, 0, ..., None].numpy())
    expected = OpenImageIO.ImageBufAlgo.demosaic(image, "bayer", "MHC", pattern).get_pixels(OpenImageIO.FLOAT)
    result = demosaicked(raw, pattern)[0, 0].movedim(0, -1).numpy()
    np.testing.assert_allclose(result[2:-2, 2:-2], expected[2:-2, 2:-2], atol=1e-6)


@pytest.mark.parametrize(("shot", "read"), [(0.01, 0.0), (0.0, 4e-4), (0.02, 1e-3)])
def test_variance_is_a_x_plus_b_and_the_mean_is_x(shot, read):
    n = 400_000
    for seed, level in enumerate((0.0, 0.1, 0.5, 2.0)):
        result = applied(Noise(shot, read), torch.full((n,), level), seed).double()
        variance = shot * level + read
        assert float(result.var()) == pytest.approx(variance, rel=0.02)
        assert float(result.mean()) == pytest.approx(level, abs=5 * (variance / n) ** 0.5 + 1e-7)


def test_samples_are_independent_and_black_has_read_noise_alone():
    result = applied(Noise(read=1.0), torch.zeros(4, 4, 3, 120, 120))
    for axis in range(result.ndim):
        first, second = result.narrow(axis, 0, result.shape[axis] - 1), result.narrow(axis, 1, result.shape[axis] - 1)
        assert abs(float((first * second).mean())) < 0.01
    views = torch.tensor([-0.5, 0.0])
    assert torch.equal(noisy(views, 0.3, 0.0, torch.ones(2)), views)
    torch.testing.assert_close(noisy(views, 0.3, 0.04, torch.ones(2)), views + 0.2)


def test_gains_multiply_and_limits_cut_off():
    views = torch.rand(2, 3, 3, 4, 5)
    assert torch.equal(applied(Exposure(2.5), views), 2.5 * views)
    gains = torch.tensor([2.0, 1.0, 0.7])[:, None, None]
    assert torch.equal(applied(WhiteBalance((2.0, 1.0, 0.7)), views), views * gains)
    values = torch.tensor([-1.0, 0.0, 0.25, 1.0, 7.0])
    assert applied(Clipping(), values).tolist() == [0, 0, 0.25, 1, 1]
    assert applied(Clipping(0.5, 1e30), values).tolist() == [0.5, 0.5, 0.5, 1, 7]


@pytest.mark.parametrize("bits", [1, 8, 20])
def test_quantisation_rounds_to_the_nearest_of_all_steps(bits):
    values, steps = torch.rand(100_000) * 1.2 - 0.1, 2**bits - 1
    rounded = applied(Quantisation(bits), values)
    assert float((rounded - values).abs().max()) <= 0.5 / steps + 1e-7
    on_grid = rounded.double() * steps
    torch.testing.assert_close(on_grid, on_grid.round(), atol=steps * 2e-7, rtol=0)


def test_srgb_has_the_values_of_the_standard_and_gamma_is_a_root():
    radiance = torch.tensor([0.0031308, 0.214041, 0.5], dtype=torch.float64)
    expected = torch.tensor([0.04045, 0.5, 0.735357], dtype=torch.float64)
    torch.testing.assert_close(applied(ToneCurve("srgb"), radiance), expected, atol=1e-6, rtol=0)
    radiance = torch.tensor([0.25, -0.25, 4.0])
    torch.testing.assert_close(applied(ToneCurve("gamma", 2.0), radiance), torch.tensor([0.5, -0.5, 2.0]))
