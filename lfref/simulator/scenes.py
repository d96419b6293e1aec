"""Random scenes in plain numbers: a full background, and islands of all outlines in front of it."""

import math
from collections.abc import Callable

import torch
from torch import Generator

from lfref.errors import InputError
from lfref.simulator.mattes import Disc, Full, Leaf, Outline, Perforated, Polygon, Twigs
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import STEEPEST, Plane
from lfref.simulator.textures import Checker, Colour, Flat, Gradient, Noise, Picture, Stripes, Texture


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


def random_scene(
    generator: Generator,
    camera: Camera,
    n_surfaces: tuple[int, int] = (3, 5),
    disparities: tuple[float, float] = (-1.0, 1.0),
    slant: float = 0.0,
    pictures: tuple[str, ...] = (),
) -> Scene:
    """Draw a scene of matte surfaces.

    Args:
        generator: Source of randomness; it fixes the scene with all its textures.
        camera: What looks at it.
        n_surfaces: Fewest and most surfaces.
        disparities: Range to draw from, in pixels per view step.
        slant: Greatest change of disparity a pixel along each axis; surfaces then may cross each other.
        pictures: Image files to take some textures from.

    Returns:
        The scene, its surfaces from far to near.

    Raises:
        InputError: An empty range, or a slant that is too steep for the camera.
    """
    if not (1 <= n_surfaces[0] <= n_surfaces[1] and disparities[0] <= disparities[1]):
        raise InputError("ranges must go from small to large, with one surface at least", got=(n_surfaces, disparities))
    if not 0 <= slant * sum(camera.half_aperture) <= STEEPEST:
        raise InputError("slant must be from 0 to 0.5 / (half the view rows + half the columns)", got=slant)
    dice = Dice(generator)
    drawn = sorted(dice.uniform(*disparities) for _ in range(dice.whole(*n_surfaces)))
    tone = Tone(1 - 0.75 * dice.uniform(), 1 - 0.75 * dice.uniform())
    surfaces = []
    for index, disparity in enumerate(drawn):
        plane = Plane(disparity, (dice.uniform(-slant, slant), dice.uniform(-slant, slant)))
        matte = _outline(dice, camera) if index else Full()
        surfaces.append(Surface(plane, _texture(dice, tone, camera, pictures), matte))
    return Scene(camera, tuple(surfaces), seed=dice.whole(0, 2**31 - 1))


def _texture(dice: Dice, tone: Tone, camera: Camera, pictures: tuple[str, ...]) -> Texture:
    if pictures and dice.uniform() < 0.5:
        name = pictures[dice.whole(0, len(pictures) - 1)]
        return Picture(name, max(camera.size) * dice.uniform(1, 2))
    return TEXTURES[dice.whole(0, len(TEXTURES) - 1)](dice, tone)


def _noise(dice: Dice, tone: Tone) -> Texture:
    tint, strength = dice.colour(0.5, 1.5), dice.uniform(0.1, 0.33)
    contrast = tone((strength * tint[0], strength * tint[1], strength * tint[2]))
    return Noise(tone(dice.colour(0.15, 0.85)), contrast, dice.uniform(1, 2), dice.uniform(), 0.03 * tone.brightness)


def _two_colours(dice: Dice, tone: Tone) -> tuple[Colour, Colour, float, float]:
    """The arguments that all waves have after their period."""
    return tone(dice.colour(0, 0.9)), tone(dice.colour(0.1, 1)), dice.uniform(0, 180), dice.uniform()


def _checker(dice: Dice, tone: Tone) -> Texture:
    return Checker(dice.uniform(6, 60), *_two_colours(dice, tone))


def _stripes(dice: Dice, tone: Tone) -> Texture:
    return Stripes(dice.uniform(4, 40), *_two_colours(dice, tone))


def _gradient(dice: Dice, tone: Tone) -> Texture:
    return Gradient(dice.uniform(100, 600), *_two_colours(dice, tone))


def _flat(dice: Dice, tone: Tone) -> Texture:
    return Flat(tone(dice.colour(0, 1)))


TEXTURES: tuple[Callable[[Dice, Tone], Texture], ...] = (_noise,) * 6 + (_checker, _stripes, _gradient, _flat)
"""Drawn from evenly; most of what there is to see is no regular pattern."""


def _outline(dice: Dice, camera: Camera) -> Outline:
    # The radius of a disc that covers 10 to 35 % of the picture.
    radius = (dice.uniform(0.1, 0.35) * camera.size[0] * camera.size[1] / math.pi) ** 0.5
    return OUTLINES[dice.whole(0, len(OUTLINES) - 1)](dice, camera, max(radius, 1.0))


def _disc(dice: Dice, camera: Camera, radius: float) -> Outline:
    return Disc(radius, dice.within(camera))


def _polygon(dice: Dice, camera: Camera, radius: float) -> Outline:
    (x, y), n_corners, turn = dice.within(camera), dice.whole(3, 9), dice.uniform(0, 2 * math.pi)
    corners = []
    for n in range(n_corners):
        angle, reach = turn + 2 * math.pi * n / n_corners, radius * dice.uniform(0.7, 1.5)
        corners.append((x + reach * math.cos(angle), y + reach * math.sin(angle)))
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
    *(_disc, _polygon, _leaf, _twigs) * 2,
    _perforated,
)
"""Drawn from evenly; a lattice before everything is rare."""
