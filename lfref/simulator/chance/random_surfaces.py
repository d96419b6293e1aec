"""Random parts of surfaces: outlines, textures, curved shapes, materials. What to draw them from is in `scenes`."""

import math
from collections.abc import Callable

from lfref.simulator.chance.dice import Dice, Range, Tone
from lfref.simulator.materials import Emissive, Glass, Glossy, Material, Mirror
from lfref.simulator.mattes import Disc, Leaf, Outline, Perforated, Polygon, Twigs
from lfref.simulator.scene import Camera
from lfref.simulator.surfaces import STEEPEST, Dome
from lfref.simulator.textures import Checker, Colour, Flat, Gradient, Noise, Picture, Stripes, Texture


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
    return Noise(tone(dice.colour(0.15, 0.85)), contrast, dice.uniform(1, 2), dice.uniform(), 0.03 * tone.brightness)


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
