"""Tone curves: values of the standard, and monotone."""

import pytest
import torch

from lfref.simulator.effects.response import ToneCurve

from .conftest import GRID, applied

CURVES = [ToneCurve(), ToneCurve("srgb"), ToneCurve("gamma"), ToneCurve("gamma", 0.5), ToneCurve("gamma", 1.0)]


@pytest.mark.parametrize("curve", CURVES)
def test_it_is_monotone_and_keeps_black_and_white(curve):
    made = applied(curve, torch.linspace(-0.2, 1.5, 10_001, dtype=torch.float64))
    assert bool((made.diff() > 0).all())
    ends = applied(curve, torch.tensor([0.0, 1.0], dtype=torch.float64))
    torch.testing.assert_close(ends, torch.tensor([0.0, 1.0], dtype=torch.float64), atol=1e-12, rtol=0)


def test_srgb_has_the_values_of_the_standard():
    radiance = torch.tensor([0.0031308, 0.214041, 0.5], dtype=torch.float64)
    expected = torch.tensor([0.04045, 0.5, 0.735357], dtype=torch.float64)
    torch.testing.assert_close(applied(ToneCurve("srgb"), radiance), expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("curve", CURVES)
def test_it_can_be_undone(curve):
    radiance = torch.linspace(-0.2, 1.5, 1001, dtype=torch.float64)
    torch.testing.assert_close(curve.encoding.decode(applied(curve, radiance)), radiance, atol=1e-7, rtol=1e-6)


def test_gamma_is_a_root():
    radiance = torch.tensor([0.25, -0.25, 4.0])
    torch.testing.assert_close(applied(ToneCurve("gamma", 2.0), radiance), torch.tensor([0.5, -0.5, 2.0]))


def test_only_a_straight_line_is_inert():
    reasons = [curve.inert(GRID) for curve in CURVES]
    assert reasons == ["the curve is linear", None, None, None, "the curve is linear"]
