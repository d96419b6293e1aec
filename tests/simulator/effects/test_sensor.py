"""A sensor holds one effect of its kind a field, in the order of the light."""

from dataclasses import fields

import pytest

from lfref.errors import InputError
from lfref.simulator.effects.noise import Noise
from lfref.simulator.effects.response import Exposure
from lfref.simulator.effects.sensor import EFFECTS, Sensor


def test_fields_are_called_as_their_effects():
    assert [field.name for field in fields(Sensor)] == [effect.name for effect in EFFECTS.values()]


def test_everything_is_off_unless_told():
    assert not any(vars(Sensor()).values())
    assert hash(Sensor(noise=Noise(0.1))) == hash(Sensor(noise=Noise(0.1)))


def test_an_effect_in_the_wrong_field_is_refused():
    with pytest.raises(InputError, match="a sensor's noise must be one of Noise; got Exposure"):
        Sensor(noise=Exposure(2.0))
    with pytest.raises(InputError, match="a sensor's exposure must be one of Exposure; got 2"):
        Sensor(exposure=2.0)
