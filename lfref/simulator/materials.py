"""Materials: what a surface does with light, beyond the colours of its texture.

Letters: `X Y`, `p q` and `x y` as in `surfaces`.
"""

from dataclasses import dataclass
from typing import ClassVar

from lfref.simulator import checks
from lfref.simulator.textures import Flat, Texture


class Material:
    """What a surface does with light."""

    lengths: ClassVar[tuple[str, ...]]  # fields in pixels or in pixels per view step


@dataclass(frozen=True)
class Matte(Material):
    """A matte material: it looks the same from everywhere (Lambert)."""

    lengths = ()


@dataclass(frozen=True)
class Emissive(Material):
    """A material that shines by itself: its light is the colour times a gain, whatever the scene's light."""

    lengths = ()
    gain: float = 1.0

    def __post_init__(self) -> None:
        checks.numbers("an emissive gain", [self.gain], least=0)


@dataclass(frozen=True)
class Glossy(Material):
    """A material with a round highlight that moves over the surface with the aperture point.

    The light of the highlight is strength * exp(-r^2 / (2 width^2)), where r is the distance of (X, Y) from the point
    centre + drift (p, q).
    """

    lengths = ("width", "drift", "centre")
    strength: float = 0.5  # radiance at the centre of the highlight under a light of gain 1
    width: float = 12.0  # standard deviation in pixels
    drift: float = 4.0  # movement over the surface in pixels per view step
    centre: tuple[float, float] = (0.0, 0.0)  # (X, Y) of the highlight in the central view

    def __post_init__(self) -> None:
        checks.freeze(self)
        checks.numbers("a highlight's strength", [self.strength], least=0)
        checks.numbers("a highlight's width", [self.width], checks.TINY)
        checks.numbers("a highlight's drift", [self.drift])
        checks.pair("a highlight's centre", self.centre)


@dataclass(frozen=True)
class _Reflecting(Material):
    """A material that mirrors a texture at another disparity: `share` of the light comes from the texture."""

    lengths = ("disparity",)
    share: float  # Reflectance, from 0 to 1
    texture: Texture = Flat()  # noqa: RUF009  frozen
    """The mirrored picture."""
    disparity: float = -2.0  # disparity of the mirrored picture in pixels per view step

    def __post_init__(self) -> None:
        checks.numbers("a reflectance", [self.share], 0, 1)
        checks.kind("a mirrored texture", self.texture, Texture)
        checks.numbers("a mirrored disparity", [self.disparity])


@dataclass(frozen=True)
class Mirror(_Reflecting):
    """A mirror."""

    share: float = 0.8


@dataclass(frozen=True)
class Glass(_Reflecting):
    """A mirror of a small share; give its surface a small opacity, so that the background shines through."""

    share: float = 0.15


def reflectance(material: Material) -> float:
    """Share of the light that comes from a mirrored picture."""
    return material.share if isinstance(material, _Reflecting) else 0.0


def is_glossy(material: Material) -> bool:
    """Whether a highlight shows; one that does not drift counts too, though it could be painted."""
    return isinstance(material, Glossy) and material.strength > 0
