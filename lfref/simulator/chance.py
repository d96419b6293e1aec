"""Random parts of surfaces: outlines, textures, curved shapes, materials. What to draw them from is in `scenes`."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import torch
from torch import Generator

from lfref.simulator import checks
from lfref.simulator.effects.crosstalk import Crosstalk
from lfref.simulator.effects.displacement import Chromatic, Misalignment
from lfref.simulator.effects.mosaic import PATTERNS, Mosaic
from lfref.simulator.effects.noise import Noise
from lfref.simulator.effects.response import Clipping, Exposure, Quantisation, ToneCurve, WhiteBalance
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.effects.vignetting import Vignetting
from lfref.simulator.materials import Emissive, Glass, Glossy, Material, Mirror
from lfref.simulator.mattes import Disc, Leaf, Outline, Perforated, Polygon, Twigs
from lfref.simulator.scene import Camera
from lfref.simulator.surfaces import STEEPEST, Dome
from lfref.simulator.textures import Checker, Colour, Flat, Gradient, Picture, Stripes, Texture
from lfref.simulator.textures import Noise as NoiseTexture

# PART dice
# Numbers of random scenes, drawn from a generator: ranges, shares, colours, places.

Thing = TypeVar("Thing")

Range = tuple[float, float]
"""Least and greatest number to draw."""


class Dice:
    """Numbers drawn from a generator.

    Args:
        generator: Source of randomness.
    """

    def __init__(self, generator: Generator) -> None:
        self.generator = generator

    def uniform(self, low: float = 0.0, high: float = 1.0) -> float:
        """A number between two others."""
        return low + (high - low) * float(torch.rand((), generator=self.generator))

    def whole(self, low: int, high: int) -> int:
        """A whole number from one to another, both included."""
        return int(torch.randint(low, high + 1, (), generator=self.generator))

    def one_of(self, things: Sequence[Thing]) -> Thing:
        """Any of some things, all alike."""
        return things[self.whole(0, len(things) - 1)]

    def happens(self, share: float) -> bool:
        """Whether what happens in that share of all cases happens; what never does takes no number."""
        return share > 0 and self.uniform() < share

    def chosen(self, shares: Sequence[float]) -> int | None:
        """The place of one of several cases that exclude each other, or None; impossible ones take no number.

        Args:
            shares: Of each case, 0 to 1, together 1 at most.
        """
        if not any(shares):
            return None
        at = self.uniform()
        return next((place for place in range(len(shares)) if at < sum(shares[: place + 1])), None)

    def colour(self, low: float, high: float) -> Colour:
        """Red, green and blue, each between two numbers."""
        return self.uniform(low, high), self.uniform(low, high), self.uniform(low, high)

    def within(self, camera: Camera) -> tuple[float, float]:
        """A point of the central view, from its centre."""
        height, width = camera.size
        return self.uniform(-width / 2, width / 2), self.uniform(-height / 2, height / 2)


class Tone:
    """How bright and how colourful a scene is as a whole, as photographs are.

    Args:
        brightness: Factor of all colours.
        saturation: 1 keeps colours, 0 leaves grey.
    """

    def __init__(self, brightness: float, saturation: float) -> None:
        self.brightness = brightness
        self.saturation = saturation

    def __call__(self, colour: Colour) -> Colour:
        """The colour as it is in such a scene."""
        grey = sum(colour) / 3
        red, green, blue = (self.brightness * (grey + self.saturation * (value - grey)) for value in colour)
        return red, green, blue


# PART random_sensor
# Random sensors: which effects a scene's optics and sensor have, and how strong they are.

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


def texture(dice: Dice, tone: Tone, camera: Camera, pictures: tuple[str, ...]) -> Texture:
    """A texture, half of all from pictures where there are any.

    Args:
        dice: What to draw with.
        tone: Of the scene.
        camera: What looks at it.
        pictures: Image files.
    """
    if pictures and dice.uniform() < 0.5:
        name = dice.one_of(pictures)
        return Picture(name, max(camera.size) * dice.uniform(1, 2))
    return dice.one_of(TEXTURES)(dice, tone)


def _noise(dice: Dice, tone: Tone) -> Texture:
    tint, strength = dice.colour(0.5, 1.5), dice.uniform(0.1, 0.33)
    contrast = tone((strength * tint[0], strength * tint[1], strength * tint[2]))
    return NoiseTexture(
        tone(dice.colour(0.15, 0.85)), contrast, dice.uniform(1, 2), dice.uniform(), 0.03 * tone.brightness
    )


def _two_colours(dice: Dice, tone: Tone) -> tuple[Colour, Colour, float, float]:
    """The arguments that all waves have after their period."""
    return tone(dice.colour(0, 0.9)), tone(dice.colour(0.1, 1)), dice.uniform(0, 180), dice.uniform()


TEXTURES: tuple[Callable[[Dice, Tone], Texture], ...] = (
    *(_noise,) * 6,
    lambda dice, tone: Checker(dice.uniform(6, 60), *_two_colours(dice, tone)),
    lambda dice, tone: Stripes(dice.uniform(4, 40), *_two_colours(dice, tone)),
    lambda dice, tone: Gradient(dice.uniform(100, 600), *_two_colours(dice, tone)),
    lambda dice, tone: Flat(tone(dice.colour(0, 1))),
)
"""Drawn from evenly; most of what there is to see is no regular pattern."""


def outline(dice: Dice, camera: Camera) -> Outline:
    """The outline of an island in the picture.

    Args:
        dice: What to draw with.
        camera: What looks at it.
    """
    # The radius of a disc that covers 10 to 35 % of the picture.
    radius = (dice.uniform(0.1, 0.35) * camera.size[0] * camera.size[1] / math.pi) ** 0.5
    return dice.one_of(OUTLINES)(dice, camera, max(radius, 1.0))


def _polygon(dice: Dice, camera: Camera, radius: float) -> Outline:
    (x, y), n_corners, turn = dice.within(camera), dice.whole(3, 9), dice.uniform(0, 2 * math.pi)
    corners = []
    for n in range(n_corners):
        angle, off = turn + 2 * math.pi * n / n_corners, radius * dice.uniform(0.7, 1.5)
        corners.append((x + off * math.cos(angle), y + off * math.sin(angle)))
    return Polygon(tuple(corners))


def _leaf(dice: Dice, camera: Camera, radius: float) -> Outline:
    return Leaf(3 * radius, radius * dice.uniform(0.6, 1.8), dice.uniform(0, 360), dice.within(camera))


def _twigs(dice: Dice, camera: Camera, radius: float) -> Outline:
    width, angle = dice.uniform(1, 5), dice.uniform(0, 360)
    return Twigs(radius, width, dice.whole(2, 5), angle, dice.within(camera), dice.whole(0, 2**31 - 1))


def _perforated(dice: Dice, camera: Camera, radius: float) -> Outline:
    pitch = dice.uniform(8, 48)
    return Perforated(pitch, pitch * dice.uniform(0.25, 0.43), dice.uniform(0, 90))


OUTLINES: tuple[Callable[[Dice, Camera, float], Outline], ...] = (
    *(lambda dice, camera, radius: Disc(radius, dice.within(camera)), _polygon, _leaf, _twigs) * 2,
    _perforated,
)
"""Drawn from evenly; a lattice before everything is rare."""


def dome(dice: Dice, camera: Camera, disparity: float, bulge: Range) -> Dome:
    """A bump or hollow, as high as it can be without being too steep for the camera.

    Args:
        dice: What to draw with.
        camera: What looks at it.
        disparity: Of its foot, in pixels per view step.
        bulge: Range of its height, likewise.
    """
    radius = max(camera.size) * dice.uniform(0.2, 0.6)
    limit = 0.9 * STEEPEST / sum(Dome(0.0, 1.0, radius).steepness()) * 2 / sum(camera.half_aperture)
    height = max(-limit, min(limit, dice.uniform(*bulge)))
    return Dome(disparity, height, radius, dice.within(camera))


def _glossy(dice: Dice, tone: Tone, camera: Camera, disparities: Range) -> Material:
    width = max(camera.size) * dice.uniform(0.03, 0.12)
    return Glossy(dice.uniform(0.2, 0.8) * tone.brightness, width, dice.uniform(-0.3, 0.3) * width, dice.within(camera))


def _shown(dice: Dice, tone: Tone, disparities: Range) -> tuple[Texture, float]:
    """What mirrors and glass show."""
    return dice.one_of(TEXTURES)(dice, tone), dice.uniform(*disparities)


MATERIALS: dict[str, Callable[[Dice, Tone, Camera, Range], Material]] = {
    "glossy": _glossy,
    "mirror": lambda dice, tone, camera, disparities: Mirror(dice.uniform(0.5, 0.95), *_shown(dice, tone, disparities)),
    "glass": lambda dice, tone, camera, disparities: Glass(dice.uniform(0.05, 0.3), *_shown(dice, tone, disparities)),
    "emissive": lambda dice, tone, camera, disparities: Emissive(dice.uniform(1, 4)),
}
"""All but matte: functions of the dice, the scene's tone, the camera, and the range of mirrored disparities."""
