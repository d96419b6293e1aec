"""Where scenes come from: one after the other drawn from a distribution, or the same few again and again.

Every scene is fixed by (seed, epoch, index) alone.
"""

import abc
import dataclasses
from dataclasses import dataclass

import numpy as np
from torch import Generator

from lfref.errors import InputError
from lfref.simulator import chance, checks
from lfref.simulator.chance import MATERIALS, Dice, RandomSensor, Range, Tone
from lfref.simulator.materials import Glass, Material, Matte
from lfref.simulator.mattes import Full
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import STEEPEST, Geometry, Plane

SHARES = ("domes", *MATERIALS, "translucent", "moving")


class Scenes(abc.ABC):
    """Scenes by their place."""

    @abc.abstractmethod
    def scene(self, seed: int, epoch: int, index: int) -> Scene:
        """One scene, with a name of its own in its epoch.

        Args:
            seed: Of all scenes, at least 0.
            epoch: From 0.
            index: Its place in the epoch.
        """


@dataclass(frozen=True)
class Fixed(Scenes):
    """The same scenes one after the other, and from the first again with other textures and noise.

    In the first round of epoch 0 the seed is added to their own: seed 0 gives the scenes as they are.
    """

    scenes: tuple[Scene, ...]
    """At least one, of different names."""

    def __post_init__(self) -> None:
        if not self.scenes:
            raise InputError("there must be at least one scene", got="none")

    def scene(self, seed: int, epoch: int, index: int) -> Scene:
        """As in `Scenes`."""
        again, place = divmod(index, len(self.scenes))
        scene = self.scenes[place]
        added = _key(seed, epoch, again) % 2**62 if epoch or again else seed
        name = f"{scene.name or 'scene'}{f'_{again}' if again else ''}"
        return dataclasses.replace(scene, name=name, seed=scene.seed + added)


@dataclass(frozen=True)
class RandomScenes(Scenes):
    """Scenes without end: a full background, and islands of all outlines in front of it.

    Shares are of all surfaces, from 0 to 1. What has the share 0 takes no random number.
    """

    camera: Camera = Camera()  # noqa: RUF009  frozen
    n_surfaces: tuple[int, int] = (3, 5)
    """Fewest and most surfaces."""
    disparities: Range = (-1.0, 1.0)
    """In pixels per view step."""
    slant: float = 0.0
    """Greatest change of disparity a pixel along each axis; surfaces then may cross each other."""
    pictures: tuple[str, ...] = ()
    """Image files to take some textures from."""
    domes: float = 0.0
    """Share of surfaces that are curved."""
    bulge: Range = (-0.5, 0.5)
    """What the top of a dome has more, in pixels per view step."""
    glossy: float = 0.0
    mirror: float = 0.0
    glass: float = 0.0
    emissive: float = 0.0
    """Shares of the materials, together 1 at most; the rest is matte."""
    translucent: float = 0.0
    """Share of islands that let through what is behind."""
    opacity: Range = (0.3, 0.9)
    """Of those."""
    moving: float = 0.0
    """Share of surfaces that move during the exposure."""
    motion: Range = (-6.0, 6.0)
    """Of those, in pixels along each axis."""
    sensor: RandomSensor = RandomSensor()  # noqa: RUF009  frozen

    def __post_init__(self) -> None:
        checks.freeze(self)
        if not (1 <= self.n_surfaces[0] <= self.n_surfaces[1] and self.disparities[0] <= self.disparities[1]):
            got = (self.n_surfaces, self.disparities)
            raise InputError("ranges must go from small to large, with one surface at least", got=got)
        if not 0 <= self.slant * sum(self.camera.half_aperture) <= STEEPEST:
            raise InputError("slant must be from 0 to 0.5 / (half the view rows + half the columns)", got=self.slant)
        for name in SHARES:
            checks.numbers(f"the share of {name}", [getattr(self, name)], 0, 1)
        checks.numbers("the shares of materials together", [sum(getattr(self, name) for name in MATERIALS)], 0, 1)
        for what, span in (("bulges", self.bulge), ("motions", self.motion)):
            checks.span(f"the range of {what}", span)
        checks.span("the range of opacities", self.opacity, 0, 1)

    def scene(self, seed: int, epoch: int, index: int) -> Scene:
        """As in `Scenes`."""
        scene = self.drawn(Generator().manual_seed(_key(seed, epoch, index)))
        # No two numbers side by side at its end: files would look like views by row and column.
        return dataclasses.replace(scene, name=f"simulated_s{seed}_e{epoch}_{index:03d}")

    def plain(self) -> "RandomScenes":
        """The same of matte surfaces that stand still."""
        return dataclasses.replace(self, glossy=0.0, mirror=0.0, glass=0.0, emissive=0.0, moving=0.0)

    def drawn(self, generator: Generator) -> Scene:
        """Draw a scene.

        Args:
            generator: Source of randomness; it fixes the scene with all its textures.

        Returns:
            The scene, its surfaces from far to near.
        """
        dice = Dice(generator)
        disparities = sorted(dice.uniform(*self.disparities) for _ in range(dice.whole(*self.n_surfaces)))
        tone = Tone(1 - 0.75 * dice.uniform(), 1 - 0.75 * dice.uniform())
        surfaces = [self._surface(dice, tone, disparity, bool(place)) for place, disparity in enumerate(disparities)]
        seed = dice.whole(0, 2**31 - 1)
        return Scene(self.camera, tuple(surfaces), sensor=self.sensor.drawn(dice), seed=seed)

    def _surface(self, dice: Dice, tone: Tone, disparity: float, is_island: bool) -> Surface:
        geometry = self._geometry(dice, disparity)
        matte = chance.outline(dice, self.camera) if is_island else Full()
        texture = chance.texture(dice, tone, self.camera, self.pictures)
        material = self._material(dice, tone)
        opacity = self._opacity(dice, material) if is_island else 1.0
        motion = (dice.uniform(*self.motion), dice.uniform(*self.motion)) if dice.happens(self.moving) else (0.0, 0.0)
        return Surface(geometry, texture, matte, material, opacity, motion)

    def _geometry(self, dice: Dice, disparity: float) -> Geometry:
        plane = Plane(disparity, (dice.uniform(-self.slant, self.slant), dice.uniform(-self.slant, self.slant)))
        return chance.dome(dice, self.camera, disparity, self.bulge) if dice.happens(self.domes) else plane

    def _material(self, dice: Dice, tone: Tone) -> Material:
        place = dice.chosen([getattr(self, name) for name in MATERIALS])
        if place is None:
            return Matte()
        return list(MATERIALS.values())[place](dice, tone, self.camera, self.disparities)

    def _opacity(self, dice: Dice, material: Material) -> float:
        if isinstance(material, Glass):
            return dice.uniform(0, 0.2)
        return dice.uniform(*self.opacity) if dice.happens(self.translucent) else 1.0


def _key(*numbers: int) -> int:
    """One seed of several numbers, each of which may be large."""
    return int(np.random.SeedSequence(numbers).generate_state(1, np.uint64)[0])
