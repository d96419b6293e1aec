"""Every effect, in several settings, keeps every contract."""

import pytest
import torch
from torch.autograd import gradcheck

from lfref.simulator.effects.optics import Chromatic, Crosstalk, Misalignment, Vignetting
from lfref.simulator.effects.recording import Clipping, Exposure, Mosaic, Noise, Quantisation, ToneCurve, WhiteBalance
from tests.simulator.drawing import applied

SHAPES = [(3, 2, 3, 6, 7), (1, 1, 3, 3, 3)]
ACTIVE = [
    Chromatic((1.02, 1.0, 0.97)), Chromatic((0.5, 1.0, 2.0), (10.0, 0.0, -10.0)), Vignetting(field=0.7),
    Vignetting(field=10.0, cats_eye=2.0), Misalignment(0.3), Misalignment(10.0), Exposure(0.0), Exposure(1e4),
    Mosaic("GRBG"), Noise(shot=1.0), Noise(shot=0.01, read=1.0), Clipping(), Clipping(0.2, 1e30), Quantisation(1),
    Quantisation(20), WhiteBalance((0.0, 1.0, 1e4)), ToneCurve("srgb"), ToneCurve("gamma", 0.1),
    ToneCurve("gamma", 10.0),
]  # fmt: skip
ANGULAR = [Chromatic(disparity=(0.2, 0.0, 0.0)), Crosstalk(0.1), Crosstalk(1 / 3)]
"""Effects that need neighbouring views."""
NEUTRAL = [
    kind() for kind in (Chromatic, Vignetting, Misalignment, Crosstalk, Exposure, Noise, WhiteBalance, ToneCurve)
]


def each(effects):
    return pytest.mark.parametrize("effect", effects, ids=repr)


@each(ACTIVE + ANGULAR)
@pytest.mark.parametrize("shape", SHAPES)
def test_an_effect_keeps_type_and_shape_and_does_not_write_to_the_views(effect, shape):
    for dtype in (torch.float32, torch.float64):
        views = torch.rand(shape, dtype=dtype) * 1.5 - 0.1
        copy = views.clone()
        result = applied(effect, views, 5)
        assert result.dtype == dtype
        assert result.shape == (*shape[:2], 1 if isinstance(effect, Mosaic) else 3, *shape[3:])
        assert bool(result.isfinite().all())
        assert torch.equal(views, copy)
        assert torch.equal(applied(effect, views, 5), result)
        assert torch.equal(result, views) == (effect in ANGULAR and shape == SHAPES[1])


@each([*NEUTRAL, ToneCurve("gamma", 1.0)])
def test_the_defaults_of_most_effects_change_nothing(effect):
    views = torch.rand(SHAPES[0]) * 1.5 - 0.1
    torch.testing.assert_close(applied(effect, views), views, atol=0, rtol=0)


@each([effect for effect in ACTIVE + ANGULAR if not isinstance(effect, Quantisation)])
def test_gradients_are_those_of_differences_and_finite_at_black(effect):
    views = (torch.rand(SHAPES[0], dtype=torch.float64) * 0.8 + 0.1).requires_grad_()
    assert gradcheck(lambda values: applied(effect, values), views, fast_mode=True)
    black = torch.zeros(SHAPES[0], requires_grad=True)
    applied(effect, black).sum().backward()
    assert bool(black.grad.isfinite().all())
