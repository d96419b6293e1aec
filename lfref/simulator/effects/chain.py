"""The effects of a sensor as passes of the planner, from the radiance that the lens offers to the views of a file."""

import functools
import math

from torch import Tensor

from lfref.simulator.effects import effect
from lfref.simulator.effects.effect import Effect
from lfref.simulator.effects.mosaic import Demosaic, Mosaic
from lfref.simulator.effects.response import Clipping
from lfref.simulator.effects.sensor import EFFECTS, Sensor
from lfref.simulator.planner import Pass

NO_MOSAIC = Mosaic(None)
OFF: dict[str, Effect] = {"mosaic": NO_MOSAIC, "clipping": Clipping(-math.inf, math.inf)}
"""What changes nothing, for effects that do something as they come."""


def sensor_passes(sensor: Sensor, grid: tuple[int, int], seed: int) -> list[Pass]:
    """A pass for every effect, those that are off included.

    Args:
        sensor: What is on.
        grid: View rows and columns.
        seed: Of what effects draw.

    Returns:
        Passes that turn the result `radiance` into the result `views`.
    """
    return [
        Pass(one.name, one.needs, one.makes, functools.partial(_applied, one, seed), one.inert(grid))
        for one in effects(sensor)
    ]


def recorded(radiance: Tensor, sensor: Sensor, seed: int) -> Tensor:
    """Views as a sensor hands them over, of the light that the lens offers.

    Args:
        radiance: Views without any effect, [V, U, 3, H, W].
        sensor: What is on.
        seed: Of what effects draw.
    """
    grid = (radiance.shape[0], radiance.shape[1])
    for one in effects(sensor):
        if one.inert(grid) is None:
            radiance = _applied(one, seed, radiance)
    return radiance


def effects(sensor: Sensor) -> tuple[Effect, ...]:
    """The effects of a sensor, harmless ones where it has none.

    Args:
        sensor: What is on.

    Returns:
        One of every kind, in the order in which they run.
    """
    chain = {name: getattr(sensor, name) or OFF.get(name) or kind() for name, kind in EFFECTS.items()}
    # Demosaicing is the first that software does with raw samples, once they are whole numbers.
    last_raw = list(chain).index("quantisation") + 1
    demosaic = Demosaic((sensor.mosaic or NO_MOSAIC).pattern)
    return (*list(chain.values())[:last_raw], demosaic, *list(chain.values())[last_raw:])


def _applied(one: Effect, seed: int, views: Tensor) -> Tensor:
    return one.apply(views, effect.generator(seed, one.name))
