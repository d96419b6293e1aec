"""Random sensors: nothing unless asked for, every effect within its range, as often as asked for."""

import dataclasses

import pytest
import torch

from lfref.errors import InputError
from lfref.simulator.chance import DRAWN, Dice, RandomSensor
from lfref.simulator.effects.sensor import Sensor

ALL = dict.fromkeys(DRAWN, 1.0)


def drawn(seed=0, **options):
    return RandomSensor(**options).drawn(Dice(torch.Generator().manual_seed(seed)))


def test_by_default_there_is_no_effect_and_no_number_is_taken():
    dice, other = (Dice(torch.Generator().manual_seed(0)) for _ in range(2))
    assert RandomSensor().drawn(dice) == Sensor()
    assert dice.uniform() == other.uniform()


def test_every_effect_of_a_sensor_can_be_drawn():
    assert set(DRAWN) == {field.name for field in dataclasses.fields(Sensor)}
    assert all(dataclasses.asdict(drawn(**ALL)).values())


@pytest.mark.parametrize("name", DRAWN)
def test_an_effect_comes_alone_and_as_often_as_asked_for(name):
    sensors = [drawn(seed, **{name: 0.5}) for seed in range(60)]
    assert 15 < sum(getattr(sensor, name) is not None for sensor in sensors) < 45
    assert all(dataclasses.replace(sensor, **{name: None}) == Sensor() for sensor in sensors)


@pytest.mark.parametrize("seed", range(8))
def test_strengths_stay_in_their_ranges(seed):
    options = RandomSensor(**ALL)
    sensor = drawn(seed, **ALL)
    for value, (low, high) in (
        (sensor.chromatic.magnification[0], options.magnification),
        (sensor.chromatic.disparity[2], options.focus),
        (sensor.vignetting.field, options.field),
        (sensor.vignetting.cats_eye, options.cats_eye),
        (sensor.misalignment.sigma, options.sigma),
        (sensor.crosstalk.leak, options.leak),
        (sensor.exposure.gain, options.gain),
        (sensor.noise.shot, options.shot),
        (sensor.noise.read, options.read),
        (sensor.quantisation.bits, options.bits),
        (sensor.white_balance.gains[2], options.gains),
    ):
        assert low <= value <= high
    assert sensor.chromatic.magnification[1] == sensor.white_balance.gains[1] == 1


@pytest.mark.parametrize(
    ("options", "said"),
    [({"noise": 1.5}, "the share of noise"), ({"gain": (2.0, 1.0)}, "the range of gain must go from small to large")],
)
def test_shares_and_ranges_that_cannot_be_are_refused(options, said):
    with pytest.raises(InputError, match=said):
        RandomSensor(**options)


def test_a_range_beyond_what_an_effect_can_have_is_refused_by_the_effect():
    with pytest.raises(InputError, match="leak"):
        drawn(crosstalk=1.0, leak=(0.5, 0.9))
