"""A camera's optics and sensor as a chain of effects on views, in the order in which light meets them.

To add an effect, write its class with `apply` in a file of this folder, and add a field to `Sensor` at its
place in the chain. Scenes then set it by `sensor.NAME: {_target_: CLASS}`. CONTRIBUTING.md lists everything else that
an effect needs.
"""

import dataclasses
import functools
from dataclasses import dataclass
from typing import get_args

import numpy as np
from torch import Generator, Tensor

from lfref.encoding import LINEAR, Encoding
from lfref.simulator import checks
from lfref.simulator.effects import Effect
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
from lfref.simulator.planner import Pass


@dataclass(frozen=True)
class Sensor(checks.Description):
    """The effects of a camera; None means no effect.

    The lens disperses and shades the pictures, misplaced lenslets displace and mix them, the exposure collects them.
    From mosaic to quantisation the samples are raw, one colour per pixel where there is a mosaic. Software comes last.
    """

    chromatic: Chromatic | None = None
    vignetting: Vignetting | None = None
    misalignment: Misalignment | None = None
    crosstalk: Crosstalk | None = None
    exposure: Exposure | None = None
    mosaic: Mosaic | None = None
    noise: Noise | None = None
    clipping: Clipping | None = None
    quantisation: Quantisation | None = None
    white_balance: WhiteBalance | None = None
    tone_curve: ToneCurve | None = None

    @property
    def encoding(self) -> Encoding:
        """The encoding of the samples of its views."""
        return LINEAR if self.tone_curve is None else self.tone_curve.encoding


EFFECTS: dict[str, type] = {field.name: get_args(field.type)[0] for field in dataclasses.fields(Sensor)}
# Demosaicing is the first step of software, on samples that are whole numbers.
ORDER = [step for name in EFFECTS for step in ([name, "demosaic"] if name == "quantisation" else [name])]


def effect_chain(sensor: Sensor) -> dict[str, Effect]:
    """The effects of a sensor by name, in the order of their application."""
    effects = {name: getattr(sensor, name) for name in ORDER if name != "demosaic"}
    if sensor.mosaic:
        effects["demosaic"] = Demosaic(sensor.mosaic.pattern)
    return {name: effects[name] for name in ORDER if effects.get(name)}


def sensor_passes(sensor: Sensor, seed: int) -> list[Pass]:
    """Passes of the planner from the result `radiance` to the result `views`, one for each effect that there is."""
    chain, needs, passes = effect_chain(sensor), "radiance", []
    for name in ORDER:
        makes = "views" if name == ORDER[-1] else f"views after {name}"
        run = functools.partial(_apply, chain.get(name), name, seed)
        passes.append(Pass(name, (needs,), makes, run, None if name in chain else "the sensor has no such effect"))
        needs = makes
    return passes


def recorded(radiance: Tensor, sensor: Sensor, seed: int) -> Tensor:
    """Views as a sensor records them, from views without any effect, [V, U, 3, H, W]."""
    for name, effect in effect_chain(sensor).items():
        radiance = _apply(effect, name, seed, radiance)
    return radiance


def _apply(effect: Effect | None, name: str, seed: int, views: Tensor) -> Tensor:
    if effect is None:
        return views
    # The name, not the place in the chain, fixes the random numbers: another effect must not change them.
    key = np.random.SeedSequence((seed, int.from_bytes(name.encode(), "big"))).generate_state(1, np.uint64)
    return effect.apply(views, Generator().manual_seed(int(key[0])))
