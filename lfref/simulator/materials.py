"""What surfaces do with light, beyond their colour.

Letters: `X Y`, `p q` and `x y` as in `surfaces`.
"""

from dataclasses import dataclass

from lfref.simulator import checks
from lfref.simulator.textures import Flat, Texture


class Material:
    """A surface's way with light."""

    @property
    def is_view_dependent(self) -> bool:
        """The same point looks different from different aperture points."""
        return False

    @property
    def own_gain(self) -> float | None:
        """Light that the surface sends out itself, as a factor of its colour; None: it shows the scene's light."""
        return None

    @property
    def reflectance(self) -> float:
        """Share of the light that comes from a mirrored picture."""
        return 0.0


@dataclass(frozen=True)
class Matte(Material):
    """The same from everywhere (Lambert)."""


@dataclass(frozen=True)
class Emissive(Material):
    """Shines by itself: its colour times a gain, whatever the light."""

    gain: float = 1.0

    def __post_init__(self) -> None:
        checks.numbers("an emissive gain", [self.gain], least=0)

    @property
    def own_gain(self) -> float:
        """As in `Material`."""
        return self.gain


@dataclass(frozen=True)
class Glossy(Material):
    """Adds a round highlight that moves over the surface with the aperture point.

    The highlight is strength * exp(-r^2 / (2 width^2)), r the distance of (X, Y) from centre + drift (p, q).
    """

    strength: float = 0.5
    """Radiance at its top, under a light of gain 1."""
    width: float = 12.0
    """Standard deviation in pixels."""
    drift: float = 4.0
    """Pixels on the surface per view step."""
    centre: tuple[float, float] = (0.0, 0.0)
    """(X, Y) of its top as the central view sees it."""

    def __post_init__(self) -> None:
        checks.freeze(self)
        checks.numbers("a highlight's strength", [self.strength], least=0)
        checks.above_zero("a highlight's width", self.width)
        checks.numbers("a highlight's drift", [self.drift])
        checks.pair("a highlight's centre", self.centre)

    @property
    def is_view_dependent(self) -> bool:
        """As in `Material`; a highlight that keeps its place could be painted, but one of no strength is none."""
        return self.strength > 0


@dataclass(frozen=True)
class _Reflecting(Material):
    share: float
    texture: Texture
    disparity: float

    def __post_init__(self) -> None:
        checks.numbers("a reflectance", [self.share], 0, 1)
        checks.kind("a mirrored texture", self.texture, Texture)
        checks.numbers("a mirrored disparity", [self.disparity])

    @property
    def is_view_dependent(self) -> bool:
        """As in `Material`."""
        return self.share > 0

    @property
    def reflectance(self) -> float:
        """As in `Material`."""
        return self.share


@dataclass(frozen=True)
class Mirror(_Reflecting):
    """Shows another texture at another disparity: a share of what is seen comes from there, the rest is its own."""

    share: float = 0.8
    """Reflectance, from 0 to 1."""
    texture: Texture = Flat()  # noqa: RUF009  frozen
    """What is mirrored."""
    disparity: float = -2.0
    """Of the mirrored picture, in pixels per view step."""


@dataclass(frozen=True)
class Glass(_Reflecting):
    """A mirror of a small share; give its surface a small opacity, and the rest shines through."""

    share: float = 0.15
    """Reflectance, from 0 to 1."""
    texture: Texture = Flat()  # noqa: RUF009  frozen
    """What is mirrored."""
    disparity: float = -2.0
    """Of the mirrored picture, in pixels per view step."""
