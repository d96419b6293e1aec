"""Sources of scenes: a fixed list that repeats, or a random distribution.

Every scene is fixed by (seed, epoch, index) alone, so that any worker process can make any of them.
"""

import abc
import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Generator

from lfref.errors import InputError
from lfref.simulator import checks
from lfref.simulator.effects.optics import Chromatic, Crosstalk, Misalignment, Vignetting
from lfref.simulator.effects.recording import (
    PATTERNS,
    Clipping,
    Exposure,
    Mosaic,
    Noise,
    Quantisation,
    ToneCurve,
    WhiteBalance,
)
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.materials import Emissive, Glass, Glossy, Material, Matte, Mirror
from lfref.simulator.mattes import Disc, Full, Leaf, Outline, Perforated, Polygon, Twigs
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import STEEPEST, Dome, Geometry, Plane
from lfref.simulator.textures import Checker, Colour, Flat, Gradient, Picture, Stripes, Texture
from lfref.simulator.textures import Noise as NoiseTexture

Item = TypeVar("Item")

Range = tuple[float, float]
"""Least and greatest number to draw."""


class Scenes(abc.ABC):
    """Scenes by index."""

    @abc.abstractmethod
    def scene(self, seed: int, epoch: int, index: int) -> Scene:
        """One scene, with a name that no other scene of its epoch has; all three numbers are at least 0."""


@dataclass(frozen=True)
class Fixed(Scenes):
    """The same scenes again and again with other textures and noise; seed 0 gives them as they are first."""

    scenes: tuple[Scene, ...]  # at least one, of different names

    def scene(self, seed: int, epoch: int, index: int) -> Scene:
        """The scene at `index` modulo their number."""
        cycle, place = divmod(index, len(self.scenes))
        scene = self.scenes[place]
        added = _combined_seed(seed, epoch, cycle) % 2**62 if epoch or cycle else seed
        name = f"{scene.name or 'scene'}{f'_{cycle}' if cycle else ''}"
        return dataclasses.replace(scene, name=name, seed=scene.seed + added)


def _combined_seed(*numbers: int) -> int:
    """One seed from numbers that may be large."""
    return int(np.random.SeedSequence(numbers).generate_state(1, np.uint64)[0])


class RandomDraws:
    """Random numbers, choices and colours from a generator."""

    def __init__(self, generator: Generator) -> None:
        self.generator = generator

    def uniform(self, low: float = 0.0, high: float = 1.0) -> float:
        """A number from `low` to `high`."""
        return low + (high - low) * float(torch.rand((), generator=self.generator))

    def integer(self, low: int, high: int) -> int:
        """A whole number from `low` to `high`, both included."""
        return int(torch.randint(low, high + 1, (), generator=self.generator))

    def choice(self, items: Sequence[Item]) -> Item:
        """One of some items, all equally likely."""
        return items[self.integer(0, len(items) - 1)]

    def happens(self, probability: float) -> bool:
        """Whether an event of this probability happens; at 0 no number is drawn, so that later draws stay the same."""
        return probability > 0 and self.uniform() < probability

    def case(self, probabilities: Sequence[float]) -> int | None:
        """Index of the drawn case, or None; the cases exclude each other. If all are impossible, no number is drawn."""
        if not any(probabilities):
            return None
        at = self.uniform()
        return next((k for k in range(len(probabilities)) if at < sum(probabilities[: k + 1])), None)

    def colour(self, low: float, high: float) -> Colour:
        """Red, green and blue, each from `low` to `high`."""
        return self.uniform(low, high), self.uniform(low, high), self.uniform(low, high)

    def point(self, camera: Camera) -> tuple[float, float]:
        """A point of the central view, from its centre."""
        height, width = camera.size
        return self.uniform(-width / 2, width / 2), self.uniform(-height / 2, height / 2)


@dataclass(frozen=True)
class Tone:
    """Brightness and saturation of a whole scene: photographs differ in both."""

    brightness: float  # factor of all colours
    saturation: float  # 1 keeps colours, 0 leaves grey

    def __call__(self, colour: Colour) -> Colour:
        """The colour with this brightness and saturation."""
        grey = sum(colour) / 3
        red, green, blue = (self.brightness * (grey + self.saturation * (value - grey)) for value in colour)
        return red, green, blue


def _noise_texture(draws: RandomDraws, tone: Tone) -> Texture:
    tint, strength = draws.colour(0.5, 1.5), draws.uniform(0.1, 0.33)
    contrast = tone((strength * tint[0], strength * tint[1], strength * tint[2]))
    colour, exponent, hardness = tone(draws.colour(0.15, 0.85)), draws.uniform(1, 2), draws.uniform()
    return NoiseTexture(colour, contrast, exponent, hardness, grain=0.03 * tone.brightness)


def _wave_options(draws: RandomDraws, tone: Tone) -> tuple[Colour, Colour, float, float]:
    """Both colours, angle and phase: the arguments after the period of every periodic texture."""
    return tone(draws.colour(0, 0.9)), tone(draws.colour(0.1, 1)), draws.uniform(0, 180), draws.uniform()


TEXTURES: tuple[Callable[[RandomDraws, Tone], Texture], ...] = (
    *(_noise_texture,) * 6,
    lambda draws, tone: Checker(draws.uniform(6, 60), *_wave_options(draws, tone)),
    lambda draws, tone: Stripes(draws.uniform(4, 40), *_wave_options(draws, tone)),
    lambda draws, tone: Gradient(draws.uniform(100, 600), *_wave_options(draws, tone)),
    lambda draws, tone: Flat(tone(draws.colour(0, 1))),
)
"""Functions that draw a texture, equally likely; six draw noise, since most textures in photographs are irregular."""


def _polygon(draws: RandomDraws, camera: Camera, radius: float) -> Outline:
    (x, y), n_corners, turn = draws.point(camera), draws.integer(3, 9), draws.uniform(0, 2 * math.pi)
    corners = []
    for n in range(n_corners):
        angle, distance = turn + 2 * math.pi * n / n_corners, radius * draws.uniform(0.7, 1.5)
        corners.append((x + distance * math.cos(angle), y + distance * math.sin(angle)))
    return Polygon(tuple(corners))


def _leaf(draws: RandomDraws, camera: Camera, radius: float) -> Outline:
    return Leaf(3 * radius, radius * draws.uniform(0.6, 1.8), draws.uniform(0, 360), draws.point(camera))


def _twigs(draws: RandomDraws, camera: Camera, radius: float) -> Outline:
    width, angle = draws.uniform(1, 5), draws.uniform(0, 360)
    return Twigs(radius, width, draws.integer(2, 5), angle, draws.point(camera), draws.integer(0, 2**31 - 1))


def _perforated(draws: RandomDraws, camera: Camera, radius: float) -> Outline:
    pitch = draws.uniform(8, 48)
    return Perforated(pitch, pitch * draws.uniform(0.25, 0.43), draws.uniform(0, 90))


OUTLINES: tuple[Callable[[RandomDraws, Camera, float], Outline], ...] = (
    *(lambda draws, camera, radius: Disc(radius, draws.point(camera)), _polygon, _leaf, _twigs) * 2,
    _perforated,
)
"""Functions that draw an outline, equally likely; the lattice is there only once, since it covers the whole picture."""


def _glossy(draws: RandomDraws, tone: Tone, camera: Camera, disparities: Range) -> Material:
    width = max(camera.size) * draws.uniform(0.03, 0.12)
    strength, drift = draws.uniform(0.2, 0.8) * tone.brightness, draws.uniform(-0.3, 0.3) * width
    return Glossy(strength, width, drift, draws.point(camera))


def _mirrored(draws: RandomDraws, tone: Tone, disparities: Range) -> tuple[Texture, float]:
    return draws.choice(TEXTURES)(draws, tone), draws.uniform(*disparities)


MATERIALS: dict[str, Callable[[RandomDraws, Tone, Camera, Range], Material]] = {
    "glossy": _glossy,
    "mirror": lambda draws, tone, camera, span: Mirror(draws.uniform(0.5, 0.95), *_mirrored(draws, tone, span)),
    "glass": lambda draws, tone, camera, span: Glass(draws.uniform(0.05, 0.3), *_mirrored(draws, tone, span)),
    "emissive": lambda draws, tone, camera, span: Emissive(draws.uniform(1, 4)),
}
"""Functions that draw a material (all but matte) from draws, the scene's tone, the camera, and mirrored disparities."""


@dataclass(frozen=True)
class RandomSensor(checks.Description):
    """Random sensors: for each effect the share of scenes that have it, from 0 to 1, and the ranges of its options."""

    chromatic: checks.Share = 0.0
    magnification: Range = (0.998, 1.002)  # magnification of red and of blue; green keeps its size and focus
    focus: Range = (-0.05, 0.05)  # disparity added to red and to blue, in pixels per view step
    vignetting: checks.Share = 0.0
    field: Range = (0.0, 0.6)
    cats_eye: Range = (0.0, 0.4)
    misalignment: checks.Share = 0.0
    sigma: Range = (0.02, 0.2)
    crosstalk: checks.Share = 0.0
    leak: Range = (0.01, 0.08)
    exposure: checks.Share = 0.0
    gain: Range = (0.7, 1.4)
    mosaic: checks.Share = 0.0
    noise: checks.Share = 0.0
    shot: Range = (0.0, 0.002)
    read: Range = (0.0, 1e-4)
    clipping: checks.Share = 0.0  # share of scenes whose samples are clipped to [0, 1]
    quantisation: checks.Share = 0.0
    bits: tuple[int, int] = (8, 12)
    white_balance: checks.Share = 0.0
    gains: Range = (0.8, 1.25)  # gains of red and of blue; the gain of green is 1
    tone_curve: checks.Share = 0.0  # share of scenes with the curve of sRGB

    def draw(self, draws: RandomDraws) -> Sensor:
        """A sensor; effects of share 0 draw no numbers. A range that an effect does not allow raises InputError."""
        drawn = {name: make(self, draws) for name, make in RANDOM_EFFECTS.items() if draws.happens(getattr(self, name))}
        return Sensor(**drawn)


def _around_green(green: float, draws: RandomDraws, span: Range) -> tuple[float, float, float]:
    return draws.uniform(*span), green, draws.uniform(*span)


RANDOM_EFFECTS: dict[str, Callable[[RandomSensor, RandomDraws], Any]] = {
    "chromatic": lambda of, draws: Chromatic(
        _around_green(1, draws, of.magnification), _around_green(0, draws, of.focus)
    ),
    "vignetting": lambda of, draws: Vignetting(draws.uniform(*of.field), draws.uniform(*of.cats_eye)),
    "misalignment": lambda of, draws: Misalignment(draws.uniform(*of.sigma)),
    "crosstalk": lambda of, draws: Crosstalk(draws.uniform(*of.leak)),
    "exposure": lambda of, draws: Exposure(draws.uniform(*of.gain)),
    "mosaic": lambda of, draws: Mosaic(draws.choice(list(PATTERNS))),
    "noise": lambda of, draws: Noise(draws.uniform(*of.shot), draws.uniform(*of.read)),
    "clipping": lambda of, draws: Clipping(),
    "quantisation": lambda of, draws: Quantisation(draws.integer(*of.bits)),
    "white_balance": lambda of, draws: WhiteBalance(_around_green(1, draws, of.gains)),
    "tone_curve": lambda of, draws: ToneCurve("srgb"),
}
"""Field of `Sensor` -> a function of the shares and ranges that draws its effect, in the order of the draws."""


@dataclass(frozen=True)
class RandomScenes(checks.Description, Scenes):
    """Random scenes: a full background, and islands of all outlines in front of it.

    Shares are parts of all surfaces, from 0 to 1; an option of share 0 draws no random number.
    """

    camera: Camera = Camera()  # noqa: RUF009  frozen
    n_surfaces: tuple[int, int] = (3, 5)  # least and greatest number of surfaces
    disparities: Range = (-1.0, 1.0)  # range of disparities in pixels per view step
    slant: float = 0.0
    """Greatest change of disparity per pixel along each axis; surfaces may then cross each other."""
    pictures: tuple[str, ...] = ()  # image files; if there are any, half of the textures are such pictures
    domes: checks.Share = 0.0  # share of curved surfaces
    bulge: Range = (-0.5, 0.5)  # height of domes in pixels per view step
    glossy: checks.Share = 0.0
    mirror: checks.Share = 0.0
    glass: checks.Share = 0.0
    emissive: checks.Share = 0.0  # the shares of these four materials are together at most 1; the rest is matte
    translucent: checks.Share = 0.0  # share of islands that the background shines through
    opacity: tuple[checks.Share, checks.Share] = (0.3, 0.9)  # opacity of translucent islands
    moving: checks.Share = 0.0  # share of surfaces that move during the exposure
    motion: Range = (-6.0, 6.0)  # movement of moving surfaces, in pixels along each axis
    sensor: RandomSensor = RandomSensor()

    def __post_init__(self) -> None:
        super().__post_init__()
        shares = [getattr(self, name) for name in MATERIALS]
        if sum(shares) > 1:
            raise InputError("the shares of materials must be at most 1 together", got=shares)

    def scene(self, seed: int, epoch: int, index: int) -> Scene:
        """The scene that seed, epoch and index fix."""
        scene = self.draw(Generator().manual_seed(_combined_seed(seed, epoch, index)))
        # Its name must not end in two numbers: readers would take its files for views by row and column.
        return dataclasses.replace(scene, name=f"simulated_s{seed}_e{epoch}_{index:03d}")

    def plain(self) -> "RandomScenes":
        """The same distribution with matte surfaces that stand still."""
        return dataclasses.replace(self, glossy=0.0, mirror=0.0, glass=0.0, emissive=0.0, moving=0.0)

    def draw(self, generator: Generator) -> Scene:
        """A random scene with its surfaces from far to near; the generator fixes the scene and all its textures."""
        draws = RandomDraws(generator)
        disparities = sorted(draws.uniform(*self.disparities) for _ in range(draws.integer(*self.n_surfaces)))
        tone = Tone(1 - 0.75 * draws.uniform(), 1 - 0.75 * draws.uniform())
        surfaces = [self._surface(draws, tone, disparity, k > 0) for k, disparity in enumerate(disparities)]
        seed = draws.integer(0, 2**31 - 1)
        return Scene(self.camera, tuple(surfaces), sensor=self.sensor.draw(draws), seed=seed)

    def _surface(self, draws: RandomDraws, tone: Tone, disparity: float, is_island: bool) -> Surface:
        # The order of the draws is part of the distribution: figures in the docs were measured on its scenes.
        slants = (draws.uniform(-self.slant, self.slant), draws.uniform(-self.slant, self.slant))
        geometry: Geometry = Plane(disparity, slants)
        if draws.happens(self.domes):
            radius = max(self.camera.size) * draws.uniform(0.2, 0.6)
            # No higher than `Scene` allows for the camera: the steepness of a dome is proportional to its height.
            limit = 0.9 * STEEPEST / sum(Dome(0.0, 1.0, radius).steepness()) * 2 / sum(self.camera.half_aperture)
            height = max(-limit, min(limit, draws.uniform(*self.bulge)))
            geometry = Dome(disparity, height, radius, draws.point(self.camera))
        matte: Outline = Full()
        if is_island:
            # The radius of a disc that covers 10 to 35 % of the picture.
            radius = (draws.uniform(0.1, 0.35) * math.prod(self.camera.size) / math.pi) ** 0.5
            matte = draws.choice(OUTLINES)(draws, self.camera, max(radius, 1.0))
        if self.pictures and draws.uniform() < 0.5:
            path = draws.choice(self.pictures)
            texture: Texture = Picture(path, max(self.camera.size) * draws.uniform(1, 2))
        else:
            texture = draws.choice(TEXTURES)(draws, tone)
        case = draws.case([getattr(self, name) for name in MATERIALS])
        material: Material = Matte()
        if case is not None:
            material = list(MATERIALS.values())[case](draws, tone, self.camera, self.disparities)
        opacity = 1.0
        if is_island and isinstance(material, Glass):
            opacity = draws.uniform(0, 0.2)
        elif is_island and draws.happens(self.translucent):
            opacity = draws.uniform(*self.opacity)
        motion = (0.0, 0.0)
        if draws.happens(self.moving):
            motion = (draws.uniform(*self.motion), draws.uniform(*self.motion))
        return Surface(geometry, texture, matte, material, opacity, motion)
