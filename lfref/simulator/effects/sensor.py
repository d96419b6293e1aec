"""A camera's optics and sensor as a chain of effects on views, in the order in which light meets them.

To add an effect, write its class with `inert` and `apply` in a file of this folder, and add a field to `Sensor` at its
place in the chain. Scenes then set it by `sensor.NAME: {_target_: CLASS}`. CONTRIBUTING.md lists everything else that
an effect needs.
"""

import functools
import math
from dataclasses import dataclass
from typing import get_args, get_type_hints

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
class Sensor:
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

    def __post_init__(self) -> None:
        for name, effect in EFFECTS.items():
            if (value := getattr(self, name)) is not None:
                checks.kind(f"a sensor's {name}", value, effect)

    @property
    def encoding(self) -> Encoding:
        """The encoding of the samples of its views."""
        return LINEAR if self.tone_curve is None else self.tone_curve.encoding


EFFECTS: dict[str, type] = {name: get_args(hint)[0] for name, hint in get_type_hints(Sensor).items()}
"""Class of the effect in each field of a sensor."""
OFF: dict[str, Effect] = {"mosaic": Mosaic(None), "clipping": Clipping(-math.inf, math.inf)}
"""Inert forms of the effects whose defaults change views."""


def effect_chain(sensor: Sensor) -> dict[str, Effect]:
    """All effects by name, inert effects where the sensor has none, in the order of their application."""
    chain: dict[str, Effect] = {}
    for name, kind in EFFECTS.items():
        chain[name] = getattr(sensor, name) or OFF.get(name) or kind()
        if name == "quantisation":
            # Demosaicing is the first step of software, on samples that are whole numbers.
            chain["demosaic"] = Demosaic(sensor.mosaic.pattern if sensor.mosaic else None)
    return chain


def sensor_passes(sensor: Sensor, grid: tuple[int, int], seed: int) -> list[Pass]:
    """Passes of the planner from the result `radiance` to the result `views`, one for each effect."""
    passes, needs = [], "radiance"
    for name, effect in effect_chain(sensor).items():
        makes = f"views after {name}"
        passes.append(Pass(name, (needs,), makes, functools.partial(_apply, effect, name, seed), effect.inert(grid)))
        needs = makes
    passes[-1] = passes[-1]._replace(makes="views")
    return passes


def recorded(radiance: Tensor, sensor: Sensor, seed: int) -> Tensor:
    """Views as a sensor records them, from views without any effect, [V, U, 3, H, W]."""
    grid = (radiance.shape[0], radiance.shape[1])
    for name, effect in effect_chain(sensor).items():
        if effect.inert(grid) is None:
            radiance = _apply(effect, name, seed, radiance)
    return radiance


def _apply(effect: Effect, name: str, seed: int, views: Tensor) -> Tensor:
    # The name, not the place in the chain, fixes the random numbers: another effect must not change them.
    key = np.random.SeedSequence((seed, int.from_bytes(name.encode(), "big"))).generate_state(1, np.uint64)
    return effect.apply(views, Generator().manual_seed(int(key[0])))
