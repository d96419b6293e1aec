"""Every effect, in several settings, keeps every contract; what is no setting is refused."""

import math

import pytest
import torch
from torch.autograd import gradcheck

from lfref.errors import InputError
from lfref.simulator.effects.crosstalk import Crosstalk
from lfref.simulator.effects.displacement import Chromatic, Misalignment
from lfref.simulator.effects.mosaic import Demosaic, Mosaic
from lfref.simulator.effects.noise import Noise
from lfref.simulator.effects.response import Clipping, Exposure, Quantisation, ToneCurve, WhiteBalance
from lfref.simulator.effects.sensor import Sensor, effect_chain
from lfref.simulator.effects.vignetting import Vignetting


def applied(effect, views, seed=0):
    return effect.apply(views, torch.Generator().manual_seed(seed))


def assert_keeps_type_and_shape(effect, shape):
    """Type and axes stay, but for the channels of a mosaic; nothing becomes NaN, the views are not written to."""
    for dtype in (torch.float32, torch.float64):
        views = torch.rand(shape, dtype=dtype) * 1.5 - 0.1
        copy = views.clone()
        result = applied(effect, views)
        assert result.dtype == dtype
        assert result.shape == (*shape[:2], 1 if isinstance(effect, Mosaic) else 3, *shape[3:])
        assert bool(result.isfinite().all())
        assert torch.equal(views, copy)


def assert_follows_device(effect, shape):
    """What it makes lies where the views lie; tensors without values stand in for another device."""
    assert applied(effect, torch.rand(shape, device="meta")).device.type == "meta"


def assert_repeatable(effect, shape):
    """The same seed makes the same views."""
    views = torch.rand(shape)
    assert torch.equal(applied(effect, views, 5), applied(effect, views, 5))


def assert_inert_means_unchanged(effect, shape):
    """It gives a reason, and run all the same, it changes no value."""
    assert effect.inert(shape[:2])
    views = torch.rand(shape) * 1.5 - 0.1
    torch.testing.assert_close(applied(effect, views), views, atol=0, rtol=0)


def assert_changes_something(effect, shape):
    """It gives no reason to be skipped, and changes the views."""
    assert effect.inert(shape[:2]) is None
    views = torch.rand(shape) * 1.5 - 0.1
    assert not torch.equal(applied(effect, views), views)


def assert_gradients(effect, shape):
    """Derivatives are those of finite differences, and finite at black."""
    views = (torch.rand(shape, dtype=torch.float64) * 0.8 + 0.1).requires_grad_()
    assert gradcheck(lambda values: applied(effect, values), views, fast_mode=True)
    black = torch.zeros(shape, requires_grad=True)
    applied(effect, black).sum().backward()
    assert bool(black.grad.isfinite().all())


SHAPES = [(3, 2, 3, 6, 7), (1, 1, 3, 3, 3), (2, 4, 3, 9, 4)]

ACTIVE = [
    Chromatic((1.02, 1.0, 0.97)),
    Chromatic((0.5, 1.0, 2.0), (10.0, 0.0, -10.0)),
    Vignetting(field=0.7),
    Vignetting(field=10.0, cats_eye=2.0),
    Misalignment(0.3),
    Misalignment(10.0),
    Exposure(0.0),
    Exposure(1e4),
    Mosaic("GRBG"),
    Noise(shot=1.0),
    Noise(shot=0.01, read=1.0),
    Clipping(),
    Clipping(0.2, math.inf),
    Quantisation(1),
    Quantisation(20),
    WhiteBalance((0.0, 1.0, 1e4)),
    ToneCurve("srgb"),
    ToneCurve("gamma", 0.1),
    ToneCurve("gamma", 10.0),
]
# These want neighbours.
ANGULAR = [Chromatic(disparity=(0.2, 0.0, 0.0)), Crosstalk(0.1), Crosstalk(1 / 3)]

INERT = [*effect_chain(Sensor()).values(), ToneCurve("gamma", 1.0)]


def each(effects):
    return pytest.mark.parametrize("effect", effects, ids=repr)


@each(ACTIVE + ANGULAR)
@pytest.mark.parametrize("shape", SHAPES)
def test_type_and_shape_stay(effect, shape):
    assert_keeps_type_and_shape(effect, shape)


@each([*ACTIVE, *ANGULAR, *INERT])
def test_views_stay_on_their_device(effect):
    assert_follows_device(effect, SHAPES[0])


@each(ACTIVE + ANGULAR)
def test_a_seed_repeats_itself(effect):
    assert_repeatable(effect, SHAPES[0])


@each(ACTIVE)
@pytest.mark.parametrize("shape", SHAPES)
def test_an_effect_that_is_on_changes_something(effect, shape):
    assert_changes_something(effect, shape)


@each(ANGULAR)
def test_an_angular_effect_wants_more_than_one_view(effect):
    assert_changes_something(effect, SHAPES[0])
    assert_inert_means_unchanged(effect, SHAPES[1])


@each(INERT)
@pytest.mark.parametrize("shape", SHAPES)
def test_an_inert_effect_changes_nothing(effect, shape):
    assert_inert_means_unchanged(effect, shape)


@each([effect for effect in ACTIVE + ANGULAR if not isinstance(effect, Quantisation)])
def test_gradients_are_right(effect):
    assert_gradients(effect, SHAPES[0])


@each([Demosaic("RGGB"), Demosaic("GBRG")])
@pytest.mark.parametrize("shape", SHAPES)
def test_demosaicing_makes_three_channels_of_one(effect, shape):
    raw = torch.rand(*shape[:2], 1, *shape[3:], dtype=torch.float64, requires_grad=True)
    made = effect.apply(raw, torch.Generator())
    assert made.shape == shape
    assert made.dtype == torch.float64
    assert effect.inert(None) is None
    assert torch.autograd.gradcheck(lambda values: effect.apply(values, torch.Generator()), raw, fast_mode=True)


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        (Chromatic, {"magnification": (1, 1)}, "magnification must have 3 numbers"),
        (Chromatic, {"magnification": 1.1}, "magnification must have 3 numbers"),
        (Chromatic, {"magnification": (1, 1, 0)}, "magnification .* at least 0.5"),
        (Chromatic, {"disparity": (0, math.nan, 0)}, "disparity must be finite"),
        (Chromatic, {"disparity": (0, 11, 0)}, "disparity .* at most 10"),
        (Vignetting, {"field": -0.1}, "field .* at least 0"),
        (Vignetting, {"cats_eye": 2.5}, "cats_eye .* at most 2"),
        (Misalignment, {"sigma": -1.0}, "sigma .* at least 0"),
        (Misalignment, {"sigma": "much"}, "sigma must be finite"),
        (Crosstalk, {"leak": 0.4}, "leak .* at most 0.333"),
        (Exposure, {"gain": math.inf}, "gain must be finite"),
        (Exposure, {"gain": -1.0}, "gain .* at least 0"),
        (Mosaic, {"pattern": "RGBG"}, "mosaic pattern must be one of RGGB"),
        (Noise, {"shot": -1e-3}, "shot and read .* at least 0"),
        (Noise, {"read": math.nan}, "shot and read must be finite"),
        (Clipping, {"low": 1.0}, "low limit below its high one"),
        (Clipping, {"high": math.nan}, "low limit below its high one"),
        (Clipping, {"high": "bright"}, "low limit below its high one"),
        (Quantisation, {"bits": 0}, "whole number from 1 to 20"),
        (Quantisation, {"bits": 8.5}, "whole number from 1 to 20"),
        (Quantisation, {"bits": True}, "whole number from 1 to 20"),
        (WhiteBalance, {"gains": (1, 1, -1)}, "gains .* at least 0"),
        (WhiteBalance, {"gains": "warm"}, "gains must have 3 numbers"),
        (ToneCurve, {"curve": "log"}, "tone curve must be one of linear, srgb, gamma"),
        (ToneCurve, {"gamma": 0.0}, "gamma .* at least 0.1"),
    ],
)
def test_what_is_no_setting_is_refused(kind, options, message):
    with pytest.raises(InputError, match=message):
        kind(**options)


@pytest.mark.parametrize("effect", [WhiteBalance([1.5, 1, 1.2]), Chromatic([1.1, 1, 1], [0, 0.1, 0])])
def test_lists_of_yaml_become_tuples(effect):
    assert effect == type(effect)(*map(tuple, vars(effect).values()))
    assert isinstance(hash(effect), int)
