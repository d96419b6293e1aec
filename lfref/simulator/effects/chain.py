"""The effects of a scene as passes of the planner, from the radiance that the lens offers to the views of a file."""

import functools
import math
from typing import TYPE_CHECKING

from torch import Tensor

from lfref.simulator.effects import effect
from lfref.simulator.effects.chromatic import Chromatic
from lfref.simulator.effects.clipping import Clipping
from lfref.simulator.effects.crosstalk import Crosstalk
from lfref.simulator.effects.demosaic import Demosaic
from lfref.simulator.effects.effect import Effect
from lfref.simulator.effects.exposure import Exposure
from lfref.simulator.effects.misalignment import Misalignment
from lfref.simulator.effects.mosaic import Mosaic
from lfref.simulator.effects.noise import Noise
from lfref.simulator.effects.quantisation import Quantisation
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.effects.tone_curve import ToneCurve
from lfref.simulator.effects.vignetting import Vignetting
from lfref.simulator.effects.white_balance import WhiteBalance
from lfref.simulator.planner import Pass

if TYPE_CHECKING:
    from lfref.simulator.scene import Scene


def sensor_passes(scene: "Scene") -> list[Pass]:
    """A pass for every effect, those that are off included.

    Args:
        scene: Whose sensor and seed count.

    Returns:
        Passes that turn the result `radiance` into the result `views`, to be planned with the scene as context.
    """
    return [
        Pass(one.name, one.needs, one.makes, functools.partial(_applied, one, scene.seed), one.inert)
        for one in effects(scene.sensor)
    ]


def effects(sensor: Sensor) -> tuple[Effect, ...]:
    """The effects of a sensor, harmless ones where it has none.

    Args:
        sensor: What is on.

    Returns:
        One of every kind, in the order in which they run.
    """
    # The way of the light: the lens makes the pictures and shades them, lenslets beside their place displace and mix
    # them, the exposure collects them. From mosaic to quantisation the samples are raw, one colour a pixel where there
    # is a mosaic. What software does with raw samples comes last.
    mosaic = sensor.mosaic or Mosaic(None)
    return (
        sensor.chromatic or Chromatic(),
        sensor.vignetting or Vignetting(),
        sensor.misalignment or Misalignment(),
        sensor.crosstalk or Crosstalk(),
        sensor.exposure or Exposure(),
        mosaic,
        sensor.noise or Noise(),
        sensor.clipping or Clipping(-math.inf, math.inf),
        sensor.quantisation or Quantisation(),
        Demosaic(mosaic.pattern),
        sensor.white_balance or WhiteBalance(),
        sensor.tone_curve or ToneCurve(),
    )


def _applied(one: Effect, seed: int, views: Tensor) -> Tensor:
    return one.apply(views, effect.generator(seed, one.name))
