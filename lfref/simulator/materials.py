"""Materials: what a surface does with light, beyond the colours of its texture.

Letters: `X Y`, `p q` and `x y` as in `surfaces`.
"""

from dataclasses import dataclass

from lfref.simulator import checks
from lfref.simulator.textures import Flat, Texture


class Material(checks.Description):
    """What a surface does with light."""


@dataclass(frozen=True)
class Matte(Material):
    """A matte material: it looks the same from everywhere (Lambert)."""


@dataclass(frozen=True)
class Emissive(Material):
    """A material that shines by itself: its light is the colour times a gain, whatever the scene's light."""

    gain: checks.NotNegative = 1.0


@dataclass(frozen=True)
class Glossy(Material):
    """A material with a round highlight that moves over the surface with the aperture point.

    Its light is strength * exp(-r^2 / (2 width^2)), r being the distance of (X, Y) from centre + drift (p, q).
    """

    lengths = ("width", "drift", "centre")
    strength: checks.NotNegative = 0.5  # radiance at the centre of the highlight under a light of gain 1
    width: checks.Positive = 12.0  # standard deviation in pixels
    drift: float = 4.0  # movement over the surface in pixels per view step
    centre: tuple[float, float] = (0.0, 0.0)  # (X, Y) of the highlight in the central view


@dataclass(frozen=True)
class _Reflecting(Material):
    """A material that mirrors a texture at another disparity: `share` of the light comes from the texture."""

    lengths = ("disparity",)
    share: checks.Share  # reflectance
    texture: Texture = Flat()  # noqa: RUF009  frozen
    """The mirrored picture."""
    disparity: float = -2.0  # disparity of the mirrored picture in pixels per view step


@dataclass(frozen=True)
class Mirror(_Reflecting):
    """A mirror."""

    share: checks.Share = 0.8


@dataclass(frozen=True)
class Glass(_Reflecting):
    """A mirror of a small share; give its surface a small opacity, so that the background shines through."""

    share: checks.Share = 0.15


def reflectance(material: Material) -> float:
    """Share of the light that comes from a mirrored picture."""
    return material.share if isinstance(material, _Reflecting) else 0.0


def is_glossy(material: Material) -> bool:
    """Whether a highlight shows; one that does not drift counts too, though it could be painted."""
    return isinstance(material, Glossy) and material.strength > 0
