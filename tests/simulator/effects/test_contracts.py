"""Every effect, in several settings, keeps every contract; settings that no effect can have are refused."""

import math

import pytest
import torch
from torch.autograd import gradcheck

from lfref.errors import InputError
from lfref.simulator.effects.optics import Chromatic, Crosstalk, Misalignment, Vignetting
from lfref.simulator.effects.recording import (
    Clipping,
    Demosaic,
    Exposure,
    Mosaic,
    Noise,
    Quantisation,
    ToneCurve,
    WhiteBalance,
)
from lfref.simulator.effects.sensor import EFFECTS, Sensor, effect_chain

SHAPES = [(3, 2, 3, 6, 7), (1, 1, 3, 3, 3)]
ACTIVE = [
    Chromatic((1.02, 1.0, 0.97)), Chromatic((0.5, 1.0, 2.0), (10.0, 0.0, -10.0)), Vignetting(field=0.7),
    Vignetting(field=10.0, cats_eye=2.0), Misalignment(0.3), Misalignment(10.0), Exposure(0.0), Exposure(1e4),
    Mosaic("GRBG"), Noise(shot=1.0), Noise(shot=0.01, read=1.0), Clipping(), Clipping(0.2, math.inf), Quantisation(1),
    Quantisation(20), WhiteBalance((0.0, 1.0, 1e4)), ToneCurve("srgb"), ToneCurve("gamma", 0.1),
    ToneCurve("gamma", 10.0),
]  # fmt: skip
ANGULAR = [Chromatic(disparity=(0.2, 0.0, 0.0)), Crosstalk(0.1), Crosstalk(1 / 3)]
"""Effects that need neighbouring views."""
INERT = [*effect_chain(Sensor()).values(), ToneCurve("gamma", 1.0)]


def test_all_effects_of_a_sensor_are_tried():
    assert set(EFFECTS.values()) == {type(effect) for effect in ACTIVE + ANGULAR}


def applied(effect, views, seed=0):
    return effect.apply(views, torch.Generator().manual_seed(seed))


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
        # An effect that gives no reason to be skipped changes something.
        assert effect.inert(shape[:2]) is not None or not torch.equal(result, views)


@each([*ACTIVE, *ANGULAR, *INERT])
def test_views_stay_on_their_device(effect):
    # Tensors without values stand in for another device.
    assert applied(effect, torch.rand(SHAPES[0], device="meta")).device.type == "meta"


@each([*ACTIVE, *ANGULAR])
def test_only_angular_effects_are_inert_for_a_single_view(effect):
    assert effect.inert(SHAPES[0][:2]) is None
    assert (effect.inert((1, 1)) is not None) is (effect in ANGULAR)


@each([*INERT, *ANGULAR])
def test_an_inert_effect_changes_nothing(effect):
    for shape in SHAPES[effect in ANGULAR :]:
        assert effect.inert(shape[:2])
        views = torch.rand(shape) * 1.5 - 0.1
        torch.testing.assert_close(applied(effect, views), views, atol=0, rtol=0)


@each([effect for effect in ACTIVE + ANGULAR if not isinstance(effect, Quantisation)])
def test_gradients_are_those_of_differences_and_finite_at_black(effect):
    views = (torch.rand(SHAPES[0], dtype=torch.float64) * 0.8 + 0.1).requires_grad_()
    assert gradcheck(lambda values: applied(effect, values), views, fast_mode=True)
    black = torch.zeros(SHAPES[0], requires_grad=True)
    applied(effect, black).sum().backward()
    assert bool(black.grad.isfinite().all())


@each([Demosaic("RGGB"), Demosaic("GBRG")])
@pytest.mark.parametrize("shape", SHAPES)
def test_demosaicing_makes_three_channels_of_one(effect, shape):
    raw = torch.rand(*shape[:2], 1, *shape[3:], dtype=torch.float64, requires_grad=True)
    pictures = applied(effect, raw)
    assert (pictures.shape, pictures.dtype) == (shape, torch.float64)
    assert effect.inert(None) is None
    assert gradcheck(lambda values: applied(effect, values), raw, fast_mode=True)


@pytest.mark.parametrize(
    ("kind", "name", "values"),
    [
        (Chromatic, "magnification", [(1, 1), 1.1, (1, 1, 0.49), (1, 2.1, 1)]),
        (Chromatic, "disparity", [(0, math.nan, 0), (0, 10.1, 0), (-10.1, 0, 0)]),
        (Vignetting, "field", [-0.1, 10.1]),
        (Vignetting, "cats_eye", [-0.1, 2.1]),
        (Misalignment, "sigma", [-0.1, 10.1, "much"]),
        (Crosstalk, "leak", [-0.1, 0.34]),
        (Exposure, "gain", [-1.0, 1.1e4, math.inf]),
        (Mosaic, "pattern", ["RGBG"]),
        (Noise, "shot", [-1e-3, 1.1]),
        (Noise, "read", [math.nan, 1.1]),
        (Clipping, "low", [1.0]),
        (Clipping, "high", [math.nan, "bright"]),
        (Quantisation, "bits", [0, 21, 8.5, True]),
        (WhiteBalance, "gains", [(1, 1, -1), (1, 1, 1.1e4), "warm"]),
        (ToneCurve, "curve", ["log"]),
        (ToneCurve, "gamma", [0.09, 10.1]),
    ],
)
def test_settings_beyond_their_limits_are_refused(kind, name, values):
    for value in values:
        with pytest.raises(InputError):
            kind(**{name: value})


@pytest.mark.parametrize("effect", [WhiteBalance([1.5, 1, 1.2]), Chromatic([1.1, 1, 1], [0, 0.1, 0])])
def test_lists_of_yaml_become_tuples(effect):
    assert effect == type(effect)(*map(tuple, vars(effect).values()))
    assert isinstance(hash(effect), int)
