"""Effects on every sample alike: exact gains, limits, steps, and the values of the standard curves."""

import math

import pytest
import torch

from lfref.simulator.effects.recording import Clipping, Exposure, Quantisation, ToneCurve, WhiteBalance


def applied(effect, views):
    return effect.apply(views, torch.Generator())


def test_gains_multiply_all_samples_or_those_of_a_channel():
    views = torch.rand(2, 3, 3, 4, 5)
    assert torch.equal(applied(Exposure(2.5), views), 2.5 * views)
    balanced = applied(WhiteBalance((2.0, 1.0, 0.7)), views)
    for channel, gain in enumerate((2.0, 1.0, 0.7)):
        assert torch.equal(balanced[:, :, channel], views[:, :, channel] * gain)


def test_values_beyond_the_limits_are_cut_off():
    views = torch.tensor([-1.0, 0.0, 0.3, 1.0, 7.0])
    assert applied(Clipping(), views).tolist() == torch.tensor([0, 0, 0.3, 1, 1]).tolist()
    assert applied(Clipping(0.5, math.inf), views).tolist() == [0.5, 0.5, 0.5, 1, 7]


@pytest.mark.parametrize("bits", [1, 8, 20])
def test_the_error_of_quantisation_is_half_a_step_at_most(bits):
    values, steps = torch.rand(100_000) * 1.2 - 0.1, 2**bits - 1
    rounded = applied(Quantisation(bits), values)
    assert float((rounded - values).abs().max()) <= 0.5 / steps + 1e-7
    on_grid = rounded.double() * steps
    torch.testing.assert_close(on_grid, on_grid.round(), atol=steps * 2e-7, rtol=0)


@pytest.mark.parametrize("bits", [1, 8])
def test_quantisation_leaves_as_many_values_as_bits_tell_apart_and_is_idempotent(bits):
    rounded = applied(Quantisation(bits), torch.linspace(0, 1, 5000))
    assert len(rounded.unique()) == 2**bits
    assert (rounded[0], rounded[-1]) == (0, 1)
    assert torch.equal(applied(Quantisation(bits), rounded), rounded)


CURVES = [ToneCurve(), ToneCurve("srgb"), ToneCurve("gamma"), ToneCurve("gamma", 0.5), ToneCurve("gamma", 1.0)]


@pytest.mark.parametrize("curve", CURVES)
def test_a_curve_is_monotone_keeps_black_and_white_and_can_be_undone(curve):
    radiance = torch.linspace(-0.2, 1.5, 10_001, dtype=torch.float64)
    encoded = applied(curve, radiance)
    assert bool((encoded.diff() > 0).all())
    ends = torch.tensor([0.0, 1.0], dtype=torch.float64)
    torch.testing.assert_close(applied(curve, ends), ends, atol=1e-12, rtol=0)
    torch.testing.assert_close(curve.encoding.decode(encoded), radiance, atol=1e-7, rtol=1e-6)


def test_srgb_has_the_values_of_the_standard_and_gamma_is_a_root():
    radiance = torch.tensor([0.0031308, 0.214041, 0.5], dtype=torch.float64)
    expected = torch.tensor([0.04045, 0.5, 0.735357], dtype=torch.float64)
    torch.testing.assert_close(applied(ToneCurve("srgb"), radiance), expected, atol=1e-6, rtol=0)
    radiance = torch.tensor([0.25, -0.25, 4.0])
    torch.testing.assert_close(applied(ToneCurve("gamma", 2.0), radiance), torch.tensor([0.5, -0.5, 2.0]))
