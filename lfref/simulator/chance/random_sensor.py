"""Random sensors: which effects a scene's optics and sensor have, and how strong they are."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lfref.simulator import checks
from lfref.simulator.chance.dice import Dice, Range
from lfref.simulator.effects.chromatic import Chromatic
from lfref.simulator.effects.clipping import Clipping
from lfref.simulator.effects.crosstalk import Crosstalk
from lfref.simulator.effects.exposure import Exposure
from lfref.simulator.effects.misalignment import Misalignment
from lfref.simulator.effects.mosaic import PATTERNS, Mosaic
from lfref.simulator.effects.noise import Noise
from lfref.simulator.effects.quantisation import Quantisation
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.effects.tone_curve import ToneCurve
from lfref.simulator.effects.vignetting import Vignetting
from lfref.simulator.effects.white_balance import WhiteBalance

RANGES = ("magnification", "focus", "field", "cats_eye", "sigma", "leak", "gain", "shot", "read", "bits", "gains")


@dataclass(frozen=True)
class RandomSensor:
    """Of each effect the share of scenes that have it, from 0 to 1, and the ranges to draw it from."""

    chromatic: float = 0.0
    magnification: Range = (0.998, 1.002)
    """Of red and of blue; green keeps its size and focus."""
    focus: Range = (-0.05, 0.05)
    """Of red and of blue, in pixels per view step."""
    vignetting: float = 0.0
    field: Range = (0.0, 0.6)
    cats_eye: Range = (0.0, 0.4)
    misalignment: float = 0.0
    sigma: Range = (0.02, 0.2)
    crosstalk: float = 0.0
    leak: Range = (0.01, 0.08)
    exposure: float = 0.0
    gain: Range = (0.7, 1.4)
    mosaic: float = 0.0
    noise: float = 0.0
    shot: Range = (0.0, 0.002)
    read: Range = (0.0, 1e-4)
    clipping: float = 0.0
    """To [0, 1]."""
    quantisation: float = 0.0
    bits: tuple[int, int] = (8, 12)
    white_balance: float = 0.0
    gains: Range = (0.8, 1.25)
    """Of red and of blue; green keeps its own."""
    tone_curve: float = 0.0
    """That of a standard screen."""

    def __post_init__(self) -> None:
        checks.freeze(self)
        for name in DRAWN:
            checks.numbers(f"the share of {name}", [getattr(self, name)], 0, 1)
        for name in RANGES:
            checks.span(f"the range of {name}", getattr(self, name))

    def drawn(self, dice: Dice) -> Sensor:
        """A sensor; effects that no scene has take no numbers.

        Args:
            dice: What to draw with.

        Raises:
            InputError: A range that leaves what its effect can have.
        """
        made = {name: make(self, dice) for name, make in DRAWN.items() if dice.happens(getattr(self, name))}
        return Sensor(**made)


def _beside(green: float, dice: Dice, span: Range) -> tuple[float, float, float]:
    """Numbers for red, green and blue, of which green's is known."""
    return dice.uniform(*span), green, dice.uniform(*span)


DRAWN: dict[str, Callable[[RandomSensor, Dice], Any]] = {
    "chromatic": lambda of, dice: Chromatic(_beside(1, dice, of.magnification), _beside(0, dice, of.focus)),
    "vignetting": lambda of, dice: Vignetting(dice.uniform(*of.field), dice.uniform(*of.cats_eye)),
    "misalignment": lambda of, dice: Misalignment(dice.uniform(*of.sigma)),
    "crosstalk": lambda of, dice: Crosstalk(dice.uniform(*of.leak)),
    "exposure": lambda of, dice: Exposure(dice.uniform(*of.gain)),
    "mosaic": lambda of, dice: Mosaic(dice.one_of(list(PATTERNS))),
    "noise": lambda of, dice: Noise(dice.uniform(*of.shot), dice.uniform(*of.read)),
    "clipping": lambda of, dice: Clipping(),
    "quantisation": lambda of, dice: Quantisation(dice.whole(*of.bits)),
    "white_balance": lambda of, dice: WhiteBalance(_beside(1, dice, of.gains)),
    "tone_curve": lambda of, dice: ToneCurve("srgb"),
}
"""A field of `Sensor`, and how its effect is drawn."""
